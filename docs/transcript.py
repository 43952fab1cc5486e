"""Runs the commands shown in docs/look.md and writes what they print: `python docs/transcript.py`.

A transcript stands between `<!-- transcript: COMMAND -->` and `<!-- end -->`. With words as arguments, only transcripts whose command
contains one of them are run again.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).resolve().parent / "look.md"
PICTURE = PAGE.parent / "demo.svg"  # of the demo whose transcript is shown
BLOCK = re.compile(r"(<!-- transcript: (.+?) -->\n```\n).*?(```\n<!-- end -->)", re.DOTALL)
WIDTH = 80


def outputs_of(commands: list[str], folder: Path) -> dict[str, str]:
    """What each command prints, run one after the other in `folder`."""
    environment = {**os.environ, "COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment.get('PATH', '')}"
    found = {}
    for command in commands:
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        lines = [line.rstrip() for line in (done.stdout + done.stderr).splitlines()]
        found[command] = "\n".join(lines)
    return found


def commands_in(text: str) -> list[str]:
    """Commands of all transcripts, in order."""
    return [match[1] for match in BLOCK.findall(text)]


def written(text: str, outputs: dict[str, str]) -> str:
    """The text with the transcripts of these commands replaced."""

    def fill(match: re.Match[str]) -> str:
        command = match[2]
        if command not in outputs:
            return match[0]
        return f"{match[1]}$ {command}\n{outputs[command]}\n{match[3]}"

    return BLOCK.sub(fill, text)


def shown(text: str, command: str) -> str:
    """What a command prints according to a page."""
    for match in BLOCK.finditer(text):
        if match[2] == command:
            body = match[0].split("```\n", 1)[1].rsplit("```", 1)[0]
            return body.split("\n", 1)[1].rstrip("\n")
    raise KeyError(command)


def main() -> None:
    """Run and write."""
    text = PAGE.read_text(encoding="utf-8")
    wanted = [c for c in commands_in(text) if not sys.argv[1:] or any(word in c for word in sys.argv[1:])]
    with tempfile.TemporaryDirectory() as folder:
        PAGE.write_text(written(text, outputs_of(wanted, Path(folder))), encoding="utf-8")
        made = Path(folder) / "demo" / "figure.svg"
        if made.is_file():
            PICTURE.write_bytes(made.read_bytes())


if __name__ == "__main__":
    main()
