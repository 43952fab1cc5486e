"""Files that a program wrote may have been planted: each is refused in a moment, in little memory and with one clear error."""

from __future__ import annotations

import gzip
import json
import lzma
import os
import re
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flighttest.cli import main as cli_main
from flighttest.datafiles import DATA_BYTES, parse_json, read_yaml, type_mismatch, write_whole
from flighttest.diagnose.records import DiagnosisData
from flighttest.documents import YamlDocument
from flighttest.errors import RecordingError
from flighttest.pipeline.identification.reporting import read_diagnosis
from flighttest.recording import Provenance, Recording, Series
from flighttest.recording.store import EVENTS_NAME, MANIFEST_NAME, read_events, read_manifest, write_recording
from flighttest.report.document import Document, Section, Table
from flighttest.report.tables import write_tables

MOST_MEMORY = 100e6  # most of it modules that are imported first here

BOMB = "format: run/1\na0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 5)
)
DEEP = 100_000


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    t_s = np.arange(50) * 0.02
    write_recording(
        folder, Recording("r", {"attitude": Series(t_s, {"roll_rad": np.sin(t_s)})}, (), Provenance("", "table", ""))
    )
    return folder


def sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 400_000_000)


def within(action: Callable[[], object]) -> object:
    """What an action gives, as long as it takes little memory."""
    tracemalloc.start()
    try:
        return action()
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MOST_MEMORY


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "anchors and aliases"),
        ("format: run/1\na: " + "[" * DEEP, "nested too deeply"),
        ("format: run/1\na: " + "{b: " * DEEP, "nested too deeply"),
        ("format: run/1\na: " + "1:" * 300_000 + "1", "digits"),
        ("format: run/1\na: !!python/object/apply:os.system ['true']", "could not determine a constructor"),
    ],
    ids=["aliases", "lists", "blocks", "number", "object"],
)
def test_a_planted_manifest_is_refused(run_dir: Path, text: str, words: str) -> None:
    (run_dir / MANIFEST_NAME).write_text(text)

    def refused() -> None:
        with pytest.raises(RecordingError, match=words):
            read_manifest(run_dir)

    within(refused)


@pytest.mark.parametrize("name", [MANIFEST_NAME, EVENTS_NAME, "diagnosis.json", "fit.yaml", "next.yaml"])
def test_a_file_is_read_only_as_far_as_its_kind_is_large(
    run_dir: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (run_dir / "diagnosis.json").write_text(json.dumps({"format": "diagnosis/1", "verdict": "EXPLAINED"}))
    if name == "next.yaml":
        (run_dir / MANIFEST_NAME).unlink()  # a folder of a diagnosis alone
    sparse(run_dir / name)
    assert within(lambda: cli_main.call(["report", str(run_dir)])) == 2
    error = capsys.readouterr().err
    assert name in error
    assert "larger than" in error


@pytest.mark.parametrize(
    "argv", [("run",), ("check",), ("fit",), ("status", "--model"), ("check", "thrust", "--vehicle")]
)
def test_a_file_that_is_named_is_read_only_so_far(
    tmp_path: Path, argv: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "large.yaml"
    sparse(path)
    assert within(lambda: cli_main.call([*argv, str(path)])) == 2
    assert capsys.readouterr().err.count("error:") == 1


@pytest.mark.parametrize(
    "text", ["[" * DEEP, '{"a":' * DEEP, '{"format": "diagnosis/1", "located": ' + "[" * 60 + "]" * 60 + "}"]
)
def test_a_nested_diagnosis_is_refused(run_dir: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (run_dir / "diagnosis.json").write_text(text)
    assert cli_main.call(["report", str(run_dir)]) == 2
    assert "nested too deeply" in " ".join(capsys.readouterr().err.split())


def test_a_nested_event_is_a_loss_of_one_line(run_dir: Path) -> None:
    good = '{"t_s": 1.0, "kind": "note", "label": "good"}'
    (run_dir / EVENTS_NAME).write_text(
        f'{good}\n{{"t_s": 1.0, "kind": "note", "label": "deep", "data": {"[" * DEEP}\n{good}\n'
    )
    markers, losses = read_events(run_dir)
    assert [m.label for m in markers] == ["good", "good"]
    assert len(losses) == 1


@pytest.mark.slow
def test_a_channel_that_claims_billions_of_rows_is_refused(run_dir: Path) -> None:
    from flighttest.recording.store import open_run

    zeros = pa.array(np.zeros(30_000_000))
    pq.write_table(
        pa.table({"t_s": zeros, **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), zeros)}),
        run_dir / "channels/attitude.parquet",
    )
    assert (run_dir / "channels/attitude.parquet").stat().st_size < 1e6

    def refused() -> None:
        with pytest.raises(RecordingError, match="30000000 rows"):
            open_run(run_dir)

    within(refused)


@pytest.mark.parametrize("compress", [gzip.compress, lzma.compress])
@pytest.mark.parametrize("name", ["log.BIN", "log.tlog", "log.ulg", "log.csv"])
def test_a_log_that_unpacks_to_far_more_than_a_log_does_is_refused(
    tmp_path: Path,
    compress: Callable[[bytes], bytes],
    name: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("flighttest.logs.opening.UNPACKED_BYTES", 1 << 20)
    heads = {".BIN": b"\xa3\x95\x80", ".ulg": b"ULog\x01\x12\x35", ".csv": b"t_s,roll_rad\n"}
    path = tmp_path / f"{name}.gz"
    path.write_bytes(compress(heads.get(Path(name).suffix, b"") + bytes(4 << 20)))
    assert cli_main.call(["import", str(path), "-o", str(tmp_path / "run")]) == 2
    assert "unpacks to more than 100 times its size" in " ".join(capsys.readouterr().err.split())


def test_a_cell_of_nested_lists_is_no_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "table.csv"
    path.write_text("t_s,v\n" + f"0.0,{'[' * DEEP}\n0.1,{'[' * DEEP}\n")
    columns = tmp_path / "columns.yaml"
    columns.write_text("format: columns/1\ncolumns:\n  t_s: {from: t_s}\n  roll_rad: {from: 'v[0]'}\n")
    assert cli_main.call(["import", str(path), "--columns", str(columns), "-o", str(tmp_path / "run")]) == 2
    assert "error:" in capsys.readouterr().err


@pytest.mark.parametrize("digits", ["1" + "0" * 310, "0x" + "f" * 300])
def test_a_number_that_no_float_holds_is_refused_by_every_reader(tmp_path: Path, digits: str) -> None:
    path = tmp_path / "data.yaml"
    path.write_text(f"format: model/1\na: {digits}\n")
    with pytest.raises(RecordingError, match="digits"):
        read_yaml(path, RecordingError, "file", "")
    assert "cannot make sense of" in str(YamlDocument("data.yaml", path.read_text()).problems[0])
    if digits.isdigit():
        with pytest.raises(ValueError, match="digits"):
            parse_json(f'{{"a": [{digits}]}}')


def test_an_event_with_such_a_number_is_a_loss(run_dir: Path) -> None:
    (run_dir / EVENTS_NAME).write_text(f'{{"t_s": 1{"0" * 350}, "kind": "note", "label": "x"}}\n')
    assert read_events(run_dir) == ((), (f"{EVENTS_NAME}:1: not an event (cut off?)",))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"candidates": [-1.0]}, "candidates[0] is '-1.0'"),
        ({"regimes": 3}, "regimes is '3'"),
        ({"regimes": [{"channel": "roll"}]}, "regimes[0].maneuver is missing"),
        ({"before": {"K": {"value": "x", "std": 1, "unit": "", "interval_95": [], "scatter": 1}}}, "before.K.value is 'x'"),
        ({"heldout": {"K": {"roll": {"rmse_after": 1}}}}, "heldout.K.roll.rmse_before is missing"),
        ({"next_flight": 5}, "next_flight is '5'"),
        ({"complete": "yes"}, "complete is 'yes'"),
        ({"format": "diagnosis/1", "smallest_detectable": {"a": None, "b": 1}, "next_flight": None, "terms": []}, ""),
    ],
)  # fmt: skip
def test_a_diagnosis_is_of_the_types_that_its_writer_states(tmp_path: Path, data: object, words: str) -> None:
    assert type_mismatch(data, DiagnosisData) == words
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"format": "diagnosis/1", **cast(dict[str, object], data)}))
    if words:
        with pytest.raises(RecordingError, match=re.escape(words)):
            read_diagnosis(path)
    else:
        assert read_diagnosis(path) == data


def test_what_is_no_yaml_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "data.yaml"
    path.write_text("a: 1\nb:\n\tc: 2\n")
    with pytest.raises(RecordingError, match=r"line 3: found character.* that cannot start any token"):
        read_yaml(path, RecordingError, "file", "")


def test_what_is_sound_is_read(tmp_path: Path) -> None:
    path = tmp_path / "data.yaml"
    path.write_text("a: [1, 2.5, yes, 2026-10-02]\nb: {c: null}\n")
    data = read_yaml(path, RecordingError, "file", "")
    assert data["a"][:3] == [1, 2.5, True]
    assert data["b"] == {"c": None}
    assert parse_json('{"a": [[1]]}') == {"a": [[1]]}
    assert DATA_BYTES > 1e6


def test_a_write_that_is_cut_short_leaves_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "model.yaml"
    write_whole(kept, "first")
    write_whole(kept, "second")
    assert kept.read_text(encoding="utf-8") == "second"

    def full(self: Path, text: str, encoding: str = "") -> int:
        self.write_bytes(text.encode()[:3])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space") as full_disk:
        write_whole(kept, "third")
    assert kept.read_bytes() == b"second"
    assert full_disk.value.filename == str(kept), "error: No space left on device, of which file was not said"
    assert [p.name for p in tmp_path.iterdir()] == ["model.yaml"], "half a file takes the space that there is not"


def test_a_table_that_does_not_fit_on_the_disk_is_named(tmp_path: Path) -> None:
    document = Document("d", "", "good", (Section("a", "a", (Table(("x",), (("1",),), ("left",)),)),))
    (name,) = (p.name for p in write_tables(document, tmp_path / "whole", "csv"))
    (tmp_path / name).symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space") as full_disk:
        write_tables(document, tmp_path, "csv")
    assert full_disk.value.filename == str(tmp_path / name)
