"""Every profile that leaves the vehicle moving after a tilt ends alike: the other side until it stands, then level."""

import pytest

from flighttest.script.load import parse_script
from flighttest.script.profiles import PROFILES

HEAD = """format: maneuver/1
name: x
doc: x
identifies: [d_x]
mode: GUIDED_NOGPS
rate_hz: 50
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.9], height_m: [2, 10], speed_max_m_s: 8}
reset: {to: [0, 0, 5], by: guided}
steps:
"""
TILTED = {
    "attitude_step": "{axis: [roll, pitch], amplitude_rad: 0.3, sign: both, entry_s: 0.7, coast_s: 1.2}",
    "3-2-1-1": "{axis: [roll, pitch], amplitude_rad: 0.3, sign: both, entry_s: 0.7, coast_s: 1.2}",
    "tilt_throttle": "{axis: [roll, pitch], tilt_rad: 0.3, throttle_0: 0.2, throttle_1: 0.3, entry_s: 0.7, coast_s: 1.2}",
}


@pytest.mark.parametrize("name", TILTED)
def test_a_tilt_is_entered_level_and_ended_by_its_other_side(name: str) -> None:
    script = parse_script(f"{HEAD}  - {name}: {TILTED[name]}\n")
    cells = [cell for step in script.steps for cell in PROFILES[step.profile].cells(step.settings, 1.0)]
    assert [tuple(cell.label[: cell.label.index("0")]) for cell in cells] == [
        tuple(f"{axis}{sign}") for axis in ("roll", "pitch") for sign in "+-"
    ]
    for cell in cells:
        assert (cell.lead[0].name, cell.lead[0].duration_s, cell.lead[0].roll_rad) == ("entry", 0.7, 0.0)
        assert cell.counter is not None
        last = cell.lead[-1]
        assert cell.counter.roll_rad == -cell.lead[1].roll_rad
        assert cell.counter.pitch_rad == -cell.lead[1].pitch_rad
        assert last.roll_rad or last.pitch_rad
        assert [(piece.name, piece.duration_s) for piece in cell.tail] == [("coast", 1.2)]
        assert cell.stops == (("counter", "vertical") if name == "tilt_throttle" else ("counter",))
