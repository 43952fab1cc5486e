"""Build step: the wheel carries the top-level folders maneuvers/ and sitl/ as data inside the package.

Everything else stands in pyproject.toml. An editable install needs no copy: `flighttest.script.shipped` looks beside the package first.
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SHIPPED = ("maneuvers", "sitl")


class BuildWithShipped(build_py):
    """`build_py` that also copies the shipped folders, except into an editable install."""

    def run(self) -> None:
        """Build the package, then copy maneuvers/ and sitl/ into its data folder."""
        super().run()
        if self.editable_mode:
            return
        root = Path(__file__).parent
        for folder in SHIPPED:
            source = root / folder
            if source.is_dir():
                target = Path(self.build_lib) / "flighttest" / "data" / folder
                ignore = shutil.ignore_patterns("__pycache__", "*.pyc", "runs")
                shutil.copytree(source, target, dirs_exist_ok=True, ignore=ignore)


setup(cmdclass={"build_py": BuildWithShipped})
