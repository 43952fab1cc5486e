"""`flighttest show`: one page about a recording, before anything is fitted."""

import json
import re

import numpy as np
import pytest

from flighttest.report.packing import MISSING, coarse, pack_series, unpacked
from flighttest.report.render import html


@pytest.fixture(scope="module")
def shown(flight_csv, tmp_path_factory):
    from flighttest.pipeline.identification.showing import show

    page = tmp_path_factory.mktemp("page") / "page.html"
    return show(flight_csv, page), page


@pytest.mark.slow
def test_the_page_says_what_flight_it_is_and_what_it_can_tell(shown):
    result, page = shown
    assert "A flight of" in result.document.verdict
    reported = {o["parameter"]: o["excited"] for o in result.data["outlook"]}
    assert reported["K"]
    assert reported["omega_phi"]
    assert all(o["excited"] == (not o["why"]) for o in result.data["outlook"])
    assert result.data["battery"]["first_v"] > result.data["battery"]["last_v"]
    assert abs(result.data["compatibility"]["velocity_late_s"]) < 0.01
    assert any(c.startswith("flighttest fit ") for c in result.data["commands"])
    assert {s.id for s in result.value.sections} >= {
        "channels",
        "identify",
        "health",
        "time",
        "segments",
        "vibration",
        "next",
    }
    assert page.stat().st_size < 2_000_000


@pytest.mark.parametrize(
    ("driven_s", "said"),
    [(0.3, "A recording of 20 s with no flight in it"), (1.0, "A recording of 20 s, 1 s of it in the air, from which")],
)
def test_a_log_of_a_vehicle_that_stands_has_no_flight_in_it(tmp_path, driven_s, said):
    """Of a log of a bench it was said: a free flight of 0 s with recorded commands; of a log with 1 s in the air, as `import` said: no
    flight in it."""
    from flighttest.pipeline.identification.showing import show

    t = np.arange(0.0, 20.0, 0.02)
    still = np.zeros(t.size)
    columns = {"t_s": t, "f_z_m_s2": still + 9.81, "roll_rad": still, "pitch_rad": still}
    columns["throttle"] = np.where((t > 10.0) & (t < 10.0 + driven_s), 0.3, 0.0)
    table = tmp_path / "bench.csv"
    np.savetxt(table, np.stack(list(columns.values()), axis=1), delimiter=",", header=",".join(columns), comments="")
    assert show(table, tmp_path / "page.html").document.verdict.startswith(said)


@pytest.mark.parametrize(("correlated", "said"), [(0.85, True), (0.95, False)])
def test_a_command_that_is_not_followed_is_named(correlated, said, tmp_path):
    """A flight with a mechanical failure, whose pitch has 0.78, had a page without a word about it."""
    from flighttest.pipeline.identification.showing import show

    t, rng = np.arange(0.0, 40.0, 0.02), np.random.default_rng(1)
    asked = 0.1 * np.sin(2 * np.pi * 0.4 * t)
    noise = asked.std() * np.sqrt(1.0 / correlated**2 - 1.0) * rng.standard_normal(t.size)
    still, flies = np.zeros(t.size), (t > 2.0) & (t < 38.0)
    columns = {
        "t_s": t,
        "pitch_rad": asked + noise,
        "pitch_ref_rad": asked,
        "roll_rad": still,
        "f_z_m_s2": still + 9.81,
    }
    columns |= {"throttle": np.where(flies, 0.3, 0.0), "height_m": np.where(flies, 5.0, 0.0)}
    table = tmp_path / "flight.csv"
    np.savetxt(table, np.stack(list(columns.values()), axis=1), delimiter=",", header=",".join(columns), comments="")
    page = tmp_path / "page.html"
    result = show(table, page)
    (found,) = result.data["followed"]
    assert (found["correlation"] < 0.9) is said
    assert ("pitch follows its command with a correlation of 0.8" in page.read_text()) is said


def test_the_page_is_offline_and_holds_every_channel(shown):
    text = shown[1].read_text()
    outside = re.sub(r"<script[^>]*>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", outside)
    about = json.loads(unpacked(text, "channels-about"))
    held = {c["name"] for one in about["series"] for c in one["channels"]}
    recording = shown[0].value.sections[0].blocks[0]
    assert held == {n for _, columns in recording.groups.values() for n in columns}
    assert set(about["shown"]) <= held
    page = (about["series"], unpacked(text, "channels-data"))
    for series, data in (page, pack_series(recording.groups, 100_000)):
        for one in series:
            t_s, columns = recording.groups[one["group"]]
            times = one["t0"] + np.cumsum(np.frombuffer(data, "<u4", one["n"], one["t"])) * 1e-5
            whole = one["n"] == t_s.size
            assert whole or data is page[1], "few enough to be kept as they are"
            assert not whole or np.abs(times - t_s).max() < 1e-4
            for c in one["channels"]:
                coded = np.frombuffer(data, "<i2", one["n"], c["at"])
                values = np.where(coded == MISSING, np.nan, c["low"] + (coded + 32500.0) * c["step"])
                recorded = columns[c["name"]]
                for extreme in (np.nanmin, np.nanmax):
                    assert abs(extreme(values) - extreme(recorded)) <= c["step"], "no peak is lost"
                assert not whole or np.nanmax(np.abs(values - recorded)) <= c["step"]


def test_a_log_without_anything_to_fit_is_shown_too(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.arange(0, 20, 0.02)
    rows = "\n".join(f"{a:.3f},{0.1 * np.sin(a):.5f}" for a in t)
    (tmp_path / "only.v2.csv").write_text(f"t_s,roll_rad\n{rows}\n")
    code, out, _ = call("show", "only.v2.csv")
    assert code == 0
    assert (tmp_path / "only.v2-show.html").is_file()
    assert "without recorded commands" in out
    assert "flighttest segment only.v2.csv --all" in out


def test_a_table_with_velocity_but_no_accelerometer_is_judged_too(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.arange(0, 20, 0.02)
    rows = "\n".join(f"{a:.3f},0,0,{0.3 * np.sin(a):.5f},0,0,{0.4 + 0.05 * np.cos(a):.4f}" for a in t)
    (tmp_path / "slow.csv").write_text(f"t_s,v_x_m_s,v_y_m_s,v_z_m_s,roll_rad,pitch_rad,throttle\n{rows}\n")
    code, out, _ = call("show", "slow.csv", "--json")
    assert code == 0
    assert json.loads(out)["outlook"]


def test_a_long_channel_keeps_its_peaks():
    t = np.linspace(0.0, 100.0, 100_000)
    y = np.sin(t)
    y[50_003] = 9.0
    y[70_001] = np.nan
    times, values = coarse(t, y, 1000)
    assert times.size <= 1000
    assert np.all(np.diff(times) > 0)
    assert np.nanmax(values) == 9.0
    assert abs(times[np.nanargmax(values)] - t[50_003]) < 0.2
    described, data = pack_series({"g": (t, {"a": y, "b": np.full(t.size, np.nan)})}, 1000)
    assert described[0]["of"] == t.size
    assert len(data) < 10_000


def test_no_line_is_drawn_where_nothing_was_recorded():
    """A gap of 26 s of a log of 2014 was a straight line from one attitude to the next."""
    t = np.concatenate([np.arange(0.0, 10.0, 0.02), np.arange(36.0, 40.0, 0.02)])
    described, data = pack_series({"attitude": (t, {"roll_rad": np.ones(t.size)})}, 10_000)
    assert described[0]["of"] == t.size
    assert described[0]["n"] == t.size + 1
    coded = np.frombuffer(data, "<i2", t.size + 1, described[0]["channels"][0]["at"])
    assert np.flatnonzero(coded == MISSING).tolist() == [500]
    steady, _ = pack_series({"attitude": (t[:500], {"roll_rad": np.ones(500)})}, 10_000)
    assert steady[0]["n"] == 500


def test_figures_and_plotly_are_packed_once(shown):
    text = shown[1].read_text()
    assert text.count('id="packed-plotly"') == text.count(f'id="{html.SPECS}"') == 1
    assert unpacked(text, "packed-plotly").startswith(b"/**\n* plotly.js v")


def excited_and_determined(log, page, columns=None):
    """What `show` says of each parameter of a log, and the names that a fit determines."""
    from flighttest.pipeline.identification.fitting import fit
    from flighttest.pipeline.identification.showing import show

    outlook = show(log, page, columns).data["outlook"]
    estimates = fit([log], columns=columns).value.estimates
    return {o["parameter"]: o for o in outlook}, {n for n, e in estimates.items() if e.identifiable}


@pytest.mark.slow
def test_two_responses_excite_no_parameter_and_what_is_not_excited_no_fit_determines(repository, tmp_path):
    """One step of roll and one of pitch in each direction: as a fit does, the page asks for three responses."""
    outlook, known = excited_and_determined(repository / "tests" / "data" / "sitl.BIN.xz", tmp_path / "page.html")
    assert not outlook["omega_phi"]["excited"]
    assert "only 2 responses" in outlook["omega_phi"]["why"]
    assert known <= {n for n, o in outlook.items() if o["excited"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("arducopter_logs/copter_3.2_2014.BIN", None),
        ("wind_tunnel/custom_figure8_NF-T_70wind.csv.gz", "neural_fly.yaml"),
        ("propeller_damage/motor_data/normal_flight", None),
    ],
)
def test_what_is_not_excited_no_fit_of_a_real_recording_determines(shared_data, repository, tmp_path, name, columns):
    path = shared_data / name
    log = sorted(path.iterdir())[0] if path.is_dir() else path
    named = None if columns is None else repository / "examples" / "columns" / columns
    outlook, known = excited_and_determined(log, tmp_path / "page.html", named)
    assert known <= {n for n, o in outlook.items() if o["excited"]}
