"""Recorded commands on a changed vehicle."""

import json
from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.identify.models.model_file import ModelFile
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate
from flighttest.report.sections.twin import replay_sections, replay_sentence
from flighttest.segments.model import Segment
from flighttest.twin.replay import HORIZON_S, replay
from flighttest.twin.what_if import outside, what_if


def stored():
    model = Model()
    values = model.start()
    cov = np.diag([0.5**2, 0.02**2])
    return ModelFile(
        model, {}, values, ("K", "d_x"), cov, {"voltage_v": [21.0, 24.0]}, {"mass_kg": 2.7}, path="model.yaml"
    )


def flight(file, values=None, throttle=0.22):
    """A pitch step under a throttle, as the model flies it."""
    t = np.arange(0.0, 1.52, 0.02)
    start = {"p_z_m": 5.0}
    step = {"pitch_ref_rad": 0.3, "roll_ref_rad": 0.0, "yaw_rate_ref_rad_s": 0.0, "throttle": throttle}
    u = {n: (np.array([-1.0, 0.1]), np.array([9.81 / 54.55 if n == "throttle" else 0.0, v])) for n, v in step.items()}
    made = simulate(file.model, values or file.values, t, start, u, {"voltage_v": (t, np.full(t.size, 22.2))})
    y = {c: made[c] for c in file.model.system.outputs} | {"voltage_v": np.full(t.size, 22.2)}
    return Segment("step", "run", "pitch_step", {"amplitude_rad": 0.3}, 0, 0.1, t, y, u)


def test_without_a_change_the_twin_flies_the_recording():
    file = stored()
    found = replay(file, [flight(file)], what_if(file, []))
    assert all(e.error < 2e-3 and e.size == 0.0 for e in found.effects.values())


def test_a_payload_is_what_the_vehicle_with_less_force_per_mass_would_have_done():
    file = stored()
    ratio = 2.7 / 3.0
    heavy = file.values | {n: ratio * file.values[n] for n in ("K", "d_x", "d_y", "d_z")}
    found = replay(file, [flight(file)], what_if(file, ["payload=0.3"]))
    real = flight(file, heavy)
    (shown,) = found.shown
    # both started with the thrust of the lighter vehicle's hover, which takes a thrust lag to differ
    assert shown.changed["v_z_m_s"][-1] == pytest.approx(real.y["v_z_m_s"][-1], abs=0.15)
    assert found.effects["v_z_m_s"].size > 0.5
    half = found.effects["v_z_m_s"].uncertainty
    assert 0.05 < half < 0.4  # 0.5 of 54.55 m/s^2 at 0.22 throttle for 1.4 s is 0.15 m/s, one sigma


def test_wind_battery_and_parameters():
    file = stored()
    windy = replay(file, [flight(file)], what_if(file, ["w_north=5"]))
    assert windy.effects["v_x_m_s"].shift > 0.5
    weak = replay(file, [flight(file)], what_if(file, ["battery=-1"]))
    assert weak.effects["v_z_m_s"].shift < -0.3
    assert what_if(file, ["K=+10%", "propeller=1.1"]).values["K"] == pytest.approx(1.21 * 54.55)
    assert what_if(file, ["ATC_ANGLE_BOOST=1"]).values["boost"] == 1.0
    assert "outside of 21.0 to 24.0 V" in outside(file, what_if(file, ["battery=26"]))
    data = {
        "effects": {c: vars(e) for c, e in windy.effects.items()},
        "changes": ["w_north 5"],
        "horizon_s": HORIZON_S,
        "starts": 1,
    }
    assert "With w_north 5: after 1.5 s the" in replay_sentence(data)
    shown = json.loads(json.dumps([{k: _lists(v) for k, v in vars(s).items()} for s in windy.shown]))
    assert [s.id for s in replay_sections(data, shown)] == ["stretches", "effects"]


def _lists(value):
    if isinstance(value, dict):
        return {k: v.tolist() for k, v in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("payload", "is not NAME=VALUE"),
        ("payload=heavy", "is not a number"),
        ("payload=-3", "would not stay above zero"),
        ("battery=500", "is not the voltage"),
        ("propeller=0", "has to be above zero"),
        ("d_w=1", "there is no change or parameter d_w"),
        ("K=1e9", "is outside"),
        ("k_x=+5%", "could change by a share"),
        ("ATC_RAT_RLL_P=0.2", "closed attitude loops"),
    ],
)
def test_what_cannot_be_asked_says_so(word, said):
    with pytest.raises(InputError, match=said):
        what_if(stored(), [word])


def test_a_payload_needs_the_mass():
    with pytest.raises(InputError, match="does not hold the mass"):
        what_if(replace(stored(), fingerprint={}), ["payload=0.1"])
