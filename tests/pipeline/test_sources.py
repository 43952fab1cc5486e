"""Several recordings at once: processes give the same, a missing cluster is said."""

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import flighttest as ft
from flighttest.errors import FlighttestError, RecordingError
from flighttest.pipeline.identification.fitting import fit, segment
from flighttest.pipeline.identification.showing import show
from flighttest.pipeline.recordings.sources import Reading, import_log, open_recording, open_recordings
from flighttest.pipeline.results import Status
from flighttest.pipeline.store.table import history


@pytest.mark.slow
def test_processes_give_the_same_bit_for_bit(flight_csv, worn_csv):
    alone = open_recordings([flight_csv, worn_csv])
    together = open_recordings([flight_csv, worn_csv], Reading(workers=2))
    assert [r.name for r in alone] == [r.name for r in together]
    for a, b in zip(alone, together, strict=True):
        for group in a.series:
            for name, values in a.series[group].columns.items():
                assert np.array_equal(values, b.series[group].columns[name], equal_nan=True)


def test_the_same_recording_twice_gets_two_names(flight_csv):
    first, second = open_recordings([flight_csv, flight_csv])
    assert first.name != second.name


def test_a_cluster_that_is_not_there_is_said(flight_csv):
    with pytest.raises(FlighttestError, match=r"distributed|cluster"):
        open_recordings([flight_csv], Reading(scheduler="tcp://127.0.0.1:1"))


@pytest.mark.slow
def test_a_cross_check_that_diverges_does_not_lose_the_fit_of_a_recorded_flight(shared_data):
    found = fit([shared_data / "arducopter_logs" / "sitl_4.7dev_steps.BIN"])
    assert found.status is Status.DONE
    assert found.value.values["omega_phi"] == pytest.approx(11.9, rel=0.3)


@pytest.mark.slow
def test_import_and_segment_account_for_every_second(flight_csv, tmp_path):
    for result in (import_log(flight_csv, tmp_path / "run"), segment([tmp_path / "run"])):
        rows = result.data["time"]
        recording = open_recordings([tmp_path / "run"])[0]
        first, last = recording.t_span_s
        assert sum(row["seconds"] for row in rows) == pytest.approx(last - first)
        assert sum(row["share"] for row in rows) == pytest.approx(1.0)
        assert rows[0]["used"]
        (section,) = (s for s in result.document.sections if s.id == "time")
        assert "are used" in section.lead + "".join(getattr(block, "brief", "") for block in section.blocks)


@pytest.mark.parametrize(("lands_s", "words"), [(20.0, "20 s of it in the air"), (0.2, "none of it in the air")])
def test_import_says_how_much_of_a_recording_was_flown(tmp_path, lands_s, words):
    """Recordings on a bench were announced as "1 min 09 s of flight"."""
    t_s = np.arange(0.0, 60.0, 0.02)
    throttle = np.where(t_s < lands_s, 0.5, 0.0)
    zero = np.zeros(t_s.size)
    log = tmp_path / "log.csv"
    columns = np.column_stack([t_s, throttle, zero, zero, np.full(t_s.size, 9.8)])
    np.savetxt(log, columns, delimiter=",", header="t_s,throttle,roll_rad,pitch_rad,f_z_m_s2", comments="")
    verdict = import_log(log, tmp_path / "run").document.verdict
    assert "A recording of 1 min 00 s" in verdict
    assert words in verdict


def test_import_and_segment_say_that_a_recording_without_commands_cannot_be_fitted(tmp_path):
    """ "62.4 of 70.6 s are used" was said of one that `fit` refused."""
    t_s = np.arange(0.0, 20.0, 0.02)
    columns = np.column_stack([t_s, 0.1 * np.sin(t_s), 0.1 * np.cos(t_s), np.full(t_s.size, 9.8)])
    log, run = tmp_path / "log.csv", tmp_path / "run"
    np.savetxt(log, columns, delimiter=",", header="t_s,roll_rad,pitch_rad,f_z_m_s2", comments="")
    with pytest.raises(FlighttestError, match="nothing says what the vehicle was asked for"):
        fit([log])
    with pytest.raises(FlighttestError, match="nothing says what the vehicle was asked for"):
        ft.diagnose(ft.read(log))
    for result in (import_log(log, run), segment([run])):
        (section,) = (s for s in result.document.sections if s.id == "time")
        said = section.lead + "".join(getattr(block, "brief", "") for block in section.blocks)
        assert "nothing says what the vehicle was asked for" in said
        assert "are used" not in said
        assert not any(row["used"] for row in result.data["time"])
    alone = segment([run])
    assert alone.document.verdict.startswith("None of the")
    assert alone.data["used"] == 0
    assert "Nothing in it can be used for a fit" in show(run, tmp_path / "show.html").document.verdict


def test_import_and_show_count_the_time_in_the_air_alike(tmp_path):
    """A flight of 2014 was 1 min 47 s in the air by `import` and 1 min 34 s by `show`: one counted what follows a loss of control."""
    t_s = np.arange(0.0, 60.0, 0.02)
    asked = 0.1 * np.sin(t_s)
    roll = np.where(t_s < 40.0, asked, 1.5)
    columns = np.column_stack([t_s, np.full(t_s.size, 0.4), asked, roll, 0.0 * t_s, np.full(t_s.size, 9.8)])
    log, run = tmp_path / "log.csv", tmp_path / "run"
    names = "t_s,throttle,roll_ref_rad,roll_rad,pitch_rad,f_z_m_s2"
    np.savetxt(log, columns, delimiter=",", header=names, comments="")
    assert "40 s of it in the air" in import_log(log, run).document.verdict
    shown = show(run, tmp_path / "show.html")
    assert dict(shown.document.facts)["in the air"] == "40 s"
    assert "flight of 40 s" in shown.document.verdict


def raises(error):
    """A function that raises it."""

    def fail(*_arguments, **_options):
        raise error

    return fail


def words_of(command):
    """The words of a command that a sentence holds between backquotes."""
    return shlex.split(command.split("`")[1])


def test_an_import_that_fails_leaves_no_folder(flight_csv, tmp_path, monkeypatch):
    """It left the first channels without a manifest, and a second attempt was refused: "exists and is not a run folder"."""
    with monkeypatch.context() as patch:
        patch.setattr("flighttest.recording.store.write_manifest", raises(OSError(28, "No space left on device")))
        with pytest.raises(OSError, match="No space left"):
            import_log(flight_csv, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_import_that_was_killed_is_done_by_the_same_command(flight_csv, tmp_path):
    killed, asked = tmp_path / "killed", tmp_path / "asked"
    import_log(flight_csv, asked)
    (killed / "channels.part").mkdir(parents=True)
    (killed / "channels.part" / "attitude.parquet").write_bytes(b"PAR1")
    import_log(flight_csv, killed)
    assert sorted(p.name for p in killed.iterdir()) == sorted(p.name for p in asked.iterdir())


@pytest.mark.parametrize("what", ["a channel", "the manifest", "no manifest"])
def test_the_command_that_is_printed_for_a_damaged_run_mends_it(what, flight_csv, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my runs").mkdir()
    log, run = tmp_path / "my runs" / "a.csv", Path("my runs/one")
    shutil.copyfile(flight_csv, log)
    import_log(log, run)
    if what == "a channel":
        channel = next((run / "channels").iterdir())
        channel.write_bytes(channel.read_bytes()[:100])
    elif what == "the manifest":
        (run / "manifest.yaml").write_text("{{{")
    else:
        (run / "manifest.yaml").unlink()
        (run / "raw.tlog").touch()
        (broken,) = history(tmp_path / "my runs").data["broken"]
        assert words_of(broken) == ["flighttest", "import", str(tmp_path / run / "raw.tlog"), "-o", str(tmp_path / run)]
        return
    with pytest.raises(RecordingError) as caught:
        open_recording(run)
    hint = caught.value.hint
    if what == "the manifest":
        assert hint == "move it away, then write it again from its log: `flighttest import LOG -o 'my runs/one'`"
        (run / "manifest.yaml").rename("away")
        import_log(log, run)
    else:
        words = words_of(hint)
        assert words[:2] == ["flighttest", "import"]
        import_log(Path(words[2]), Path(words[4]))
    assert open_recording(run).has("roll_rad")
