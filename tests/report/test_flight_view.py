"""What is said of a flight while it happens."""

import io
import math
from types import SimpleNamespace

import pytest
from rich.console import Console

from flighttest.flight.outcome import HOW_TO_STOP, HOW_TO_STOP_HANDED
from flighttest.report.render.flight_large import figure_rows, large, zone_map
from flighttest.report.render.flight_view import line, picture


def facts(**changed):
    known = {
        "leg": 3, "legs": 8, "doing": "taking off", "next": "land", "phase": "", "time_left_s": 125.0, "zone_margin_m": 4.26,
        "height_m": -0.01, "voltage_v": math.nan, "link_loss": 0.01, "silence_s": 0.0, "uplink_silence_s": 0.2, "speed_m_s": 0.0,
        "voltage_min_v": 21.0, "rates_hz": {}, "mode": "GUIDED", "stopping": False, "how_to_stop": "Ctrl-C lands", "t_s": 1.0,
        "alarm": "", "place_m": (1.0, 2.0), "zone_m": ((-15.0, 15.0), (-7.5, 7.5)),
    }  # fmt: skip
    return SimpleNamespace(**{**known, **changed})


def drawn(of, view=picture, width=120):
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(view(of))
    return console.file.getvalue()


def test_the_large_view_fits_a_terminal_of_80_columns_and_24_rows():
    text = drawn(facts(voltage_v=24.04, alarm="Radio Failsafe"), large, 80)
    rows = text.splitlines()
    assert len(rows) <= 24
    assert max(map(len, rows)) <= 80
    assert "Radio Failsafe" in rows[0]
    assert "FLYING GUIDED" in drawn(facts(), large, 80).splitlines()[0]
    assert "STOPPING" in drawn(facts(stopping=True), large, 80).splitlines()[0]
    assert "█ █ ███ █ █" not in "".join(figure_rows("-"))
    assert figure_rows("41")[0] == "█ █   █"


def test_the_map_shows_the_vehicle_in_its_zone():
    zone = ((-15.0, 15.0), (-7.5, 7.5))
    rows = zone_map((15.0, 7.5), zone).plain.splitlines()
    assert rows[0][0] == "@", "ahead and to the left"
    assert zone_map((-15.0, -7.5), zone).plain.splitlines()[8][-1] == "@"
    assert "X" in zone_map((20.0, 0.0), zone).plain.splitlines()[0]
    assert "not known" in zone_map(None, zone).plain
    assert zone_map(None, None).plain == ""


def test_a_line_says_what_is_known_and_nothing_else():
    assert line(facts()) == "step 3/8 taking off, 0.0 m up, zone 4.3 m, link 99 %, 2:05 left, next land"
    assert line(facts(doing="flying: a/r1", phase="step", voltage_v=24.04, height_m=math.nan, next="")) == (
        "step 3/8 flying: a/r1 (step), zone 4.3 m, 24.0 V, link 99 %, 2:05 left"
    )


def test_the_two_directions_of_the_link_are_shown_apart():
    deaf = facts(uplink_silence_s=4.0)
    assert "up unanswered for 4 s" in line(deaf)
    assert "up: no answer for 4.0 s" in drawn(deaf)
    mute = facts(silence_s=4.0)
    assert "down silent for 4 s" in line(mute)
    assert "up: answered" in drawn(mute)


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("view", [picture, large])
@pytest.mark.parametrize("words", [HOW_TO_STOP, HOW_TO_STOP_HANDED])
def test_how_to_stop_is_read_to_its_end_on_any_terminal(words, view, width):
    """On 80 columns it ended in "the mode swit"."""
    text = drawn(facts(how_to_stop=words), view, width)
    assert words in " ".join(text.replace("│", " ").split())


def test_a_landing_promises_no_time_that_steps_would_have_taken():
    landing = facts(doing="landing", time_left_s=math.nan, mode="LAND", stopping=True, next="")
    assert "left" not in drawn(landing)
    assert "left" not in line(landing)
    assert "stopping (LAND)" in drawn(landing).splitlines()[0]
    assert "stopping (BRAKE)" in drawn(facts(mode="BRAKE", stopping=True)), "a second Ctrl-C does not land"
    assert "LAND" not in drawn(facts(mode="BRAKE", stopping=True), large).splitlines()[0]
