"""The maneuvers that come with the program, found from any folder."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from flighttest.documents import nearest
from flighttest.errors import ScriptError

SUFFIX = ".yaml"


def maneuvers_dir() -> Path:
    """The folder of shipped maneuvers: inside the installed package, else beside it in a source tree."""
    package = Path(str(resources.files("flighttest")))
    installed = package / "data" / "maneuvers"
    return installed if installed.is_dir() else package.parent / "maneuvers"


def shipped_names() -> tuple[str, ...]:
    """Names of the shipped maneuvers, without suffix, sorted."""
    folder = maneuvers_dir()
    return tuple(sorted(p.stem for p in folder.glob(f"*{SUFFIX}"))) if folder.is_dir() else ()


def resolve(name: str) -> Path:
    """The file a person means: a path, or the name of a shipped maneuver with or without .yaml. ScriptError otherwise."""
    try:
        path = Path(name)
        if path.is_file():
            return path
        exists = path.exists()
    except (OSError, ValueError) as error:
        raise ScriptError(
            f"{name[:80]!r} is not a path: {error}", "name a script file or a shipped maneuver"
        ) from error
    if exists:
        raise ScriptError(f"{name} is a folder, not a script", "name the script file inside it")
    # `maneuvers/thrust.yaml` is how the documentation writes it, so the folder's name is accepted too.
    stem = path.name.removesuffix(SUFFIX)
    if str(path.parent) in (".", "maneuvers") and stem in shipped_names():
        return maneuvers_dir() / f"{stem}{SUFFIX}"
    guess = nearest(stem, shipped_names())
    hint = f"did you mean `{guess}`?" if guess else f"shipped maneuvers: {', '.join(shipped_names())}"
    raise ScriptError(f"there is no script {name[:80]!r}", hint)
