"""Every wrong invocation gives exit code 2 and a message about what is wrong; none gives a traceback, or writes anything."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from flighttest.cli import main as cli_main
from tests.cli.wrong import Wrong, invocations

MOST_S = 20.0  # of one, its imports included: nothing hangs, also on a busy machine


def sound(wrong: Wrong) -> bool:
    """`runs` and `models` list what is in a folder: one that holds none, or a run itself, is no mistake."""
    folder = wrong.what.removeprefix("folder: ")
    return wrong.argv[0] in ("runs", "models") and (folder == "a folder" or folder.startswith("a run"))


@pytest.mark.slow
def test_a_wrong_invocation_is_reported_and_nothing_else_happens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "things"
    tried = invocations(folder)
    before = sorted(folder.rglob("*"))
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    assert len(tried) > 400
    assert {wrong.argv[0] for wrong in tried} == set(cli_main.cli.commands)
    found = []
    for wrong in tried:
        began = time.monotonic()
        try:
            code: object = cli_main.call(list(wrong.argv))
        except Exception as error:  # noqa: BLE001  # a traceback is what is looked for
            code = f"traceback {error!r}"
        out, err = capsys.readouterr()
        if code != (0 if sound(wrong) else 2):
            found.append(f"{code}: {wrong}")
        elif not (out + err).strip() or "Traceback" in out + err or len(err) > 3000:
            found.append(f"no message of use: {wrong}: {err[:200]}")
        elif time.monotonic() - began > MOST_S:
            found.append(f"takes {time.monotonic() - began:.1f} s: {wrong}")
    assert not found, "\n".join(found)
    assert sorted(folder.rglob("*")) == before
    assert not list(here.iterdir())
