"""Run folders: what is written comes back, and what a killed flight leaves is read as far as it goes."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flighttest.errors import RecordingError
from flighttest.pipeline.identification.reporting import keep_segments
from flighttest.recording import Marker, Provenance, Recording, Series
from flighttest.recording.store import (
    events_header,
    is_remains,
    open_run,
    read_events,
    read_manifest,
    write_manifest,
    write_recording,
)


@pytest.fixture
def recording() -> Recording:
    t_s = np.array([1.0, 1.5, 2.25])
    return Recording(
        "r1",
        {
            "attitude": Series(t_s, {"roll_rad": np.array([0.1, np.nan, 0.3])}),
            "battery": Series(t_s[:2], {"voltage_v": np.array([24.0, 23.9])}),
        },
        (Marker(1.2, "leg", "a/b/r1", {"cell": {"amplitude_rad": 0.3}}), Marker(1.4, "phase", "step")),
        Provenance(
            "raw.tlog", "flight", "ab" * 32, "ArduCopter 4.7.0", {"GUID_OPTIONS": 8.0}, {"battery": {"id": "B07"}},
            clock={"offset_s": 1.5, "error_s": 0.002, "method": "timesync"}, losses=("a gap",), filters={"specific_force": 20.0},
            reference_clock="ground",
        ),
    )  # fmt: skip


def test_what_is_written_comes_back(tmp_path: Path, recording: Recording) -> None:
    write_recording(tmp_path, recording)
    back = open_run(tmp_path)
    assert back.name == recording.name
    assert back.provenance == recording.provenance
    assert back.markers == recording.markers
    for group, series in recording.series.items():
        np.testing.assert_array_equal(back.series[group].t_s, series.t_s)
        for name, values in series.columns.items():
            np.testing.assert_array_equal(back.series[group].columns[name], values)


def test_writing_again_keeps_what_others_wrote_and_drops_stale_channels(tmp_path: Path, recording: Recording) -> None:
    write_manifest(tmp_path, {"weather": "calm", "outcome": "flown"})
    write_recording(tmp_path, recording)
    fewer = Recording(recording.name, {"battery": recording.series["battery"]}, (), recording.provenance)
    write_recording(tmp_path, fewer)
    assert read_manifest(tmp_path)["weather"] == "calm"
    assert set(open_run(tmp_path).series) == {"battery"}


def test_half_an_event_is_said_and_the_rest_is_read(tmp_path: Path, recording: Recording) -> None:
    write_recording(tmp_path, recording)
    with (tmp_path / "events.jsonl").open("a") as stream:
        stream.write('{"t_s": 3.0, "kind": "pha')
    back = open_run(tmp_path)
    assert len(back.markers) == 2
    assert any("events.jsonl:4" in loss for loss in back.provenance.losses)


def test_events_are_sorted_by_time(tmp_path: Path) -> None:
    with (tmp_path / "events.jsonl").open("w") as stream:
        stream.write(events_header().decode())
        for t_s in (2.0, 1.0):
            stream.write(json.dumps({"t_s": t_s, "kind": "note", "label": "x"}) + "\n")
    markers, losses = read_events(tmp_path)
    assert [m.t_s for m in markers] == [1.0, 2.0]
    assert losses == ()


def test_a_killed_flight_names_its_raw_file(tmp_path: Path) -> None:
    write_manifest(tmp_path, {"name": "x"})
    (tmp_path / "raw.tlog").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"flighttest import .*raw\.tlog"):
        open_run(tmp_path)


@pytest.mark.parametrize("text", ["format: run/9\n", "- a\n", "format: [\n", "\xff\xfe"])
def test_a_bad_manifest_is_one_clear_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(RecordingError, match=r"manifest\.yaml"):
        read_manifest(tmp_path)


def test_no_run_folder(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not a run folder"):
        open_run(tmp_path)
    with pytest.raises(RecordingError, match="not a folder"):
        open_run(tmp_path / "nowhere")


def test_a_cut_off_channel_file(tmp_path: Path, recording: Recording) -> None:
    write_recording(tmp_path, recording)
    file = tmp_path / "channels" / "attitude.parquet"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(RecordingError, match=r"attitude\.parquet cannot be read"):
        open_run(tmp_path)


def test_every_parquet_file_names_its_format(tmp_path):
    t = np.arange(5.0)
    recording = Recording("r", {"height": Series(t, {"height_m": t})}, (), Provenance("", "table"))
    write_recording(tmp_path, recording)
    assert pq.read_schema(tmp_path / "channels" / "height.parquet").metadata[b"format"] == b"channels/1"
    kept = keep_segments(tmp_path, [])
    assert pq.read_schema(kept).metadata[b"format"] == b"segments/1"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("parameters: [1, 2]", "parameters is not a block"),
        ("parameters: {MOT_SPIN_MIN: low}", r"parameters.MOT_SPIN_MIN is not a number, but 'low'"),
        ("clock: 5", "clock is not a block"),
        ("components: {battery: 5}", "components.battery is not a block"),
        ("clock: {error_s: much}", "clock.error_s is not a number"),
        ("filters: {specific_force: [20]}", "filters.specific_force is not a number"),
        ("derived: yes", "derived is not a block"),
        ("losses: 3", "losses is not a list"),
    ],
)
def test_a_manifest_of_the_wrong_shape_is_refused(tmp_path: Path, line: str, words: str) -> None:
    (tmp_path / "manifest.yaml").write_text(f"format: run/1\n{line}\n")
    with pytest.raises(RecordingError, match=words) as error:
        read_manifest(tmp_path)
    assert "flighttest import" in error.value.hint


@pytest.mark.parametrize(
    "line",
    [
        '{"t_s": 1, "kind": "leg", "label": "x", "data": 5}',
        '{"t_s": 1, "kind": ["leg"], "label": "x"}',
        '{"t_s": NaN, "kind": "leg", "label": "x"}',
        '{"t_s": 1, "kind": "leg", "label": null}',
        "5",
    ],
)
def test_a_line_that_is_no_event_is_left_out_and_reported(tmp_path: Path, line: str) -> None:
    good = '{"t_s": 2, "kind": "note", "label": "y"}'
    (tmp_path / "events.jsonl").write_text(f'{{"format": "events/1"}}\n{line}\n{good}\n')
    markers, losses = read_events(tmp_path)
    assert [m.label for m in markers] == ["y"]
    assert losses == ("events.jsonl:2: not an event (cut off?)",)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"t_s": [0.0, 1.0], "roll_rad": ["a", "b"]}, "holds a value that is not a number"),
        ({"t_s": ["a", "b"], "roll_rad": [0.0, 1.0]}, "holds a value that is not a number"),
        ({"t_s": [1.0, 0.0], "roll_rad": [0.0, 1.0]}, "time does not increase"),
    ],
)
def test_channels_that_are_no_series_are_refused_by_file(
    tmp_path: Path, columns: dict[str, list[object]], words: str
) -> None:
    (tmp_path / "manifest.yaml").write_text("format: run/1\n")
    (tmp_path / "channels").mkdir()
    pq.write_table(pa.table(columns), tmp_path / "channels" / "attitude.parquet")
    with pytest.raises(RecordingError, match=words) as error:
        open_run(tmp_path)
    assert "attitude.parquet" in error.value.message


def test_a_value_that_nothing_measures_is_a_missing_sample():
    """The square of 1e200 is no float64: the error of a velocity was printed as infinite."""
    series = Series(np.array([0.0, 0.1, 0.2]), {"v_x_m_s": np.array([1e200, 1e30, -np.inf])})
    assert np.isnan(series.columns["v_x_m_s"]).tolist() == [True, False, True]


@pytest.mark.parametrize("t_s", [[0.0, np.inf], [-np.inf, 0.0], [np.nan]])
def test_times_are_finite(t_s):
    with pytest.raises(RecordingError, match="time does not increase"):
        Series(np.array(t_s), {"v_x_m_s": np.zeros(len(t_s))})


def test_the_sample_rate_of_a_series_is_computed_once(monkeypatch):
    """It is asked for with each of an hour's thousand segments: three hours were not imported in 100 s of processor time."""
    series = Series(np.arange(5) * 0.1, {"v_x_m_s": np.zeros(5)})
    assert series.rate_hz == pytest.approx(10.0)
    monkeypatch.setattr(np, "median", None)
    assert series.rate_hz == pytest.approx(10.0)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_the_channels_are_there_all_or_not_at_all(
    failure: BaseException, tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that was full after the first group left a folder with the attitude alone, read as a recording of nothing else."""
    write = pq.write_table

    def full(table: object, path: Path, **options: object) -> None:
        if path.name.startswith("battery"):
            raise failure
        write(table, path, **options)

    old, new = tmp_path / "old", tmp_path / "new"
    write_recording(old, recording)
    monkeypatch.setattr(pq, "write_table", full)
    later = {name: Series(series.t_s + 1.0, dict(series.columns)) for name, series in recording.series.items()}
    for folder in (old, new):
        with pytest.raises(type(failure)):
            write_recording(folder, Recording("r1", later, (), recording.provenance))
    assert list(new.iterdir()) == []
    assert sorted(p.name for p in old.iterdir()) == ["channels", "events.jsonl", "manifest.yaml"]
    kept = open_run(old)
    assert set(kept.series) == set(recording.series)
    assert all(kept.series[name].t_s[0] == 1.0 for name in kept.series), "none of the later recording"


def test_what_a_killed_program_left_of_a_run_is_no_other_folder(tmp_path: Path, recording: Recording) -> None:
    write_recording(tmp_path, recording)
    (tmp_path / "channels").rename(tmp_path / "channels.part")
    (tmp_path / "manifest.yaml").unlink()
    assert is_remains(tmp_path)
    with pytest.raises(RecordingError, match=r"was its import ended early.*`flighttest import LOG -o "):
        open_run(tmp_path)
    (tmp_path / "thesis.tex").touch()
    assert not is_remains(tmp_path)
    with pytest.raises(RecordingError, match=r"no manifest.yaml; name a folder"):
        open_run(tmp_path)
