"""The wheel carries what a user needs: the shipped maneuvers and the SITL folder, found from any folder."""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile

import pytest


@pytest.fixture(scope="module")
def unpacked(repository, tmp_path_factory):
    """A built wheel, unpacked, from a copy of the sources (so that no build folder appears in the tree)."""
    root = tmp_path_factory.mktemp("wheel")
    ignore = shutil.ignore_patterns("__pycache__", "*.pyc")
    for folder in ("flighttest", "maneuvers", "sitl"):
        if (repository / folder).is_dir():
            shutil.copytree(repository / folder, root / "source" / folder, ignore=ignore)
    for file in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        if (repository / file).is_file():
            shutil.copy(repository / file, root / "source" / file)
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(root), str(root / "source")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = root.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(root / "site")
    return root / "site"


def test_shipped_folders_and_page_assets_are_inside(repository, unpacked):
    for folder in ("maneuvers", "sitl"):
        source = repository / folder
        wanted = {
            p.relative_to(source).as_posix() for p in source.rglob("*") if p.is_file() and "__pycache__" not in p.parts
        }
        got = {
            p.relative_to(unpacked / "flighttest/data" / folder).as_posix()
            for p in (unpacked / "flighttest/data" / folder).rglob("*")
            if p.is_file()
        }
        assert wanted <= got, folder
    assert (unpacked / "flighttest/report/render/style.css").is_file()
    assert (unpacked / "flighttest/report/render/figures.js").is_file()
    assert (unpacked / "flighttest/estimation/integration/kernel.c").is_file()
    assert (unpacked / "flighttest/py.typed").is_file(), "type checkers of users look for it"


def test_a_shipped_script_is_found_from_any_folder(unpacked, tmp_path):
    code = "from flighttest.script.shipped import resolve; print(resolve('thrust.yaml'))"
    environment = {**os.environ, "PYTHONPATH": str(unpacked)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(unpacked / "flighttest/data/maneuvers/thrust.yaml")


@pytest.fixture(scope="module")
def check_types(unpacked, tmp_path_factory):
    """`mypy --strict` of a script in an environment where the wheel is installed, as text; "" where nothing is wrong."""
    home = tmp_path_factory.mktemp("user")
    venv.create(home / "venv", with_pip=False)
    (site,) = (home / "venv").glob("lib/python*/site-packages")
    shutil.copytree(unpacked / "flighttest", site / "flighttest")
    (site / "the_rest.pth").write_text(sysconfig.get_path("purelib"))  # the libraries it needs

    def check(script: str) -> str:
        (home / "user_script.py").write_text(script)
        python = home / "venv" / "bin" / "python"
        command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--python-executable", str(python)]
        clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "MYPYPATH")}
        done = subprocess.run(
            [*command, "user_script.py"], cwd=home, env=clean, capture_output=True, text=True, check=False
        )
        return "" if done.returncode == 0 else done.stdout + done.stderr

    return check


@pytest.mark.slow
def test_a_users_script_passes_strict_type_checking_against_the_wheel(repository, check_types):
    assert check_types((repository / "tests" / "conventions" / "user_script.py").read_text()) == ""


@pytest.mark.slow
def test_type_checking_sees_a_users_mistakes(check_types):
    lines = {
        "ft.fitt('flight.BIN')": 'has no attribute "fitt"',
        "ft.fit('flight.BIN', trems=['ground_effect'])": 'Unexpected keyword argument "trems" for "fit"',
        "ft.fly('thrust', sped=2.0)": 'Unexpected keyword argument "sped" for "fly"',
        "ft.run('thrust', only='flight')": 'Argument "only" to "run" has incompatible type',
        "ft.read('flight.BIN').nonsense()": '"Recording" has no attribute "nonsense"',
    }
    said = check_types("\n".join(["import flighttest as ft", "", *lines]))
    assert [complaint for complaint in lines.values() if complaint not in said] == []
