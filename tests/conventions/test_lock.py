"""requirements.lock pins, with hashes, everything pyproject.toml asks for."""

import re
import tomllib


def test_every_dependency_is_pinned_with_a_hash(repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    wanted = [
        *project["project"]["dependencies"],
        *project["dependency-groups"]["dev"],
        *project["build-system"]["requires"],
    ]
    names = {re.split(r"[<>=!~ \[]", requirement)[0].lower() for requirement in wanted}
    lock = (repository / "requirements.lock").read_text()
    pinned = {
        name.lower(): rest for name, rest in re.findall(r"(?m)^([A-Za-z0-9_.-]+)==(.*(?:\n    --hash=.*)+)", lock)
    }
    assert names <= set(pinned), names - set(pinned)
    assert all("--hash=sha256:" in rest for rest in pinned.values())
