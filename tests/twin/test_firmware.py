"""The vehicle of a model under the real firmware: frame and gains that give the identified loops."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import ModelError
from flighttest.identify.models.model_file import ModelFile
from flighttest.link.ardupilot import SentHeading
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate
from flighttest.sim.options import SimOptions
from flighttest.sim.plant_frame import FramePlant
from flighttest.sim.sitl.physics import build_motor_plant, firmware_parameters
from flighttest.twin import firmware
from flighttest.twin.firmware import firmware_options, frame_of
from flighttest.twin.firmware_loops import DEFAULTS, LOOP_S, loop_of, simulate_loop

COUNT = round(firmware.SECONDS / LOOP_S)
YAW_GAINS = {"ATC_ANG_YAW_P": 2.0, "ATC_RAT_YAW_P": 0.15, "ATC_RAT_YAW_I": 0.015, "ATC_RAT_YAW_FLTE": 20.0}


def stored(parameters=None, terms=("linear_drag",), **values):
    model = Model(terms)
    full = model.start(
        {"omega_phi": 14.0, "zeta_phi": 0.6, "omega_theta": 13.0, "zeta_theta": 0.6, "sigma_r": 6.0, **values}
    )
    print_ = {"shaping_parameters": parameters or {}}
    return ModelFile(model, {}, full, (), np.zeros((0, 0)), {"voltage_v": [21.0, 24.0]}, print_, path="model.yaml")


def test_with_recorded_gains_gain_and_lag_of_the_frame_are_found(monkeypatch):
    parameters = {n: v for n, v in DEFAULTS.items() if n.startswith(("ATC_RAT_RLL", "ATC_RAT_PIT"))}
    loop = loop_of("roll", parameters)

    def flown(_stored, axis):
        t = LOOP_S * np.arange(COUNT)
        made = [
            (step, simulate_loop(loop, 300.0, 0.02, np.full(COUNT, step), np.zeros(COUNT))[0])
            for step in firmware.STEPS[axis]
        ]
        return [firmware.Wanted(step, t, np.interp(t - 0.06, t, y)) for step, y in made]

    monkeypatch.setattr(firmware, "wanted_answers", flown)
    found = firmware.frame_of_axis(stored(parameters), "roll", loop)
    assert found.gain == pytest.approx(300.0, rel=0.02)
    assert found.lag_s == pytest.approx(0.02, rel=0.05)
    assert found.delay_s == pytest.approx(0.06, abs=1e-3)
    assert found.error < 1e-3


def test_a_frame_is_of_the_steps_as_flown_at_the_voltage_they_were_flown_at():
    parameters = {n: v for n, v in DEFAULTS.items() if n.startswith(("ATC_RAT_RLL", "ATC_RAT_PIT"))}
    loop, file = loop_of("roll", parameters), stored(parameters, alpha=1.5)
    volts = 1.1 * file.model.nominal_voltage_v
    rows = []
    for step in (0.2, 0.5):
        y = simulate_loop(loop, 300.0 * 1.1**1.5, 0.02, np.full(COUNT, step), np.zeros(COUNT))[0]
        row = {"size": step, "responses": 6, "voltage_v": volts, "period_s": 0.02, "answer": y[:400:8].tolist()}
        rows.append(row)
    file = replace(file, fit_quality={"flown_steps": {"roll": rows}})
    found = firmware.frame_of_axis(file, "roll", loop)
    assert found.flown
    assert found.gain == pytest.approx(300.0, rel=0.01)
    assert found.lag_s == pytest.approx(0.02, rel=0.03)
    assert found.delay_s == pytest.approx(0.0, abs=1e-3)
    assert not firmware.frame_of_axis(stored(parameters), "roll", loop).flown


def test_without_recorded_gains_gains_are_chosen_and_said():
    found = frame_of(stored())
    assert max(a.error for a in found.axes.values()) < 0.02
    assert found.parameters["ATC_RATE_FF_ENAB"] == 0.0
    assert found.parameters["ATC_ANG_YAW_P"] >= 1.9  # 0.01 followed the yaw rate best, and no heading was reached
    assert found.parameters["ATC_ANG_RLL_P"] == pytest.approx(14.0 / 1.2, rel=0.2)
    assert [n for n in found.notes if n.startswith("no gains of roll known: gains are chosen that leave")]
    assert "rad/s^2 at full output" in found.sentences[0]


@pytest.mark.parametrize(
    "parameters", [{"INS_GYRO_FILTER": 480.0}, {"ATC_ANG_RLL_P": 0.0}], ids=["unstable", "no gain"]
)
def test_recorded_settings_that_nothing_can_fly_with_are_left_for_chosen_gains(parameters):
    """The gyro filter's cut-off is beyond what its rate can hold: its output grows without bound."""
    recorded = {n: v for n, v in DEFAULTS.items() if n.startswith("ATC_RAT_RLL")} | parameters
    assert firmware.frame_of_axis(stored(recorded), "roll", loop_of("roll", recorded)).error > firmware.NEAR
    found = frame_of(stored(recorded))
    assert max(a.error for a in found.axes.values()) < 0.02


def test_the_loop_of_4_7_reads_its_own_names():
    assert loop_of("roll", {"ATC_ACC_R_MAX": 900.0}) == loop_of("roll", {"ATC_ACCEL_R_MAX": 90000.0})


@pytest.fixture
def frame(monkeypatch):
    """Without the fit: axes of given gains."""
    axes = {n: firmware.Axis(g, 0.01, 0.03, 0.0, {}) for n, g in (("roll", 400.0), ("pitch", 300.0), ("yaw", 50.0))}
    made = firmware.FirmwareFrame(axes, {"ATC_RAT_RLL_P": 0.1}, (), ())
    monkeypatch.setattr(firmware, "frame_of", lambda _stored: made)
    return made


def test_its_plant_turns_as_the_motors_push_and_hovers_at_the_hover_throttle(frame):
    options, _ = firmware_options(stored(T_d_thrust=0.05))
    options = SimOptions.from_json(options.to_json())
    plant = build_motor_plant(options)
    assert isinstance(plant, FramePlant)
    hover = plant.hover_throttle
    while plant.motion.on_ground or plant.motion.pz < 3.0:
        plant.step([1.3 * hover] * 4, 0.00125)
    gain = plant.voltage_gain
    for axis, signs in ((0, (-1, 1, 1, -1)), (1, (-1, 1, -1, 1)), (2, (-1, -1, 1, 1))):
        before = plant.rates_rad_s[axis]
        for _ in range(160):
            plant.step([hover + 0.01 * s for s in signs], 0.00125)
        push = 0.02 * gain * (400.0, 300.0, 50.0)[axis]
        assert plant.rates_rad_s[axis] - before == pytest.approx(push * (0.2 - 0.01), rel=0.02)
    assert firmware_parameters(options)["ATC_RAT_RLL_P"] == 0.1


@pytest.mark.parametrize("wind_m_s", [0.0, 5.0])
def test_what_air_does_to_the_thrust_it_does_to_the_moments(frame, wind_m_s):
    """Counter-steps at 4 m/s of a vehicle with translational lift were 8 mrad off on its twin, 2.4 noise floors over all steps."""
    terms = ("linear_drag", "translational_lift", "steady_wind")
    still = {"d_x": 0.0, "d_y": 0.0, "w_north": -wind_m_s, "w_west": 0.0, "w_up": 0.0}
    options, _ = firmware_options(stored(terms=terms, k_lift=0.01, **still))
    plant = build_motor_plant(options)
    while plant.motion.on_ground or plant.motion.pz < 3.0:
        plant.step([1.3 * plant.hover_throttle] * 4, 0.00125)
    before = plant.rates_rad_s[0]
    for _ in range(80):
        plant.step([plant.hover_throttle + 0.01 * s for s in (-1, 1, 1, -1)], 0.00125)
    push = 0.02 * plant.voltage_gain * 400.0 * (1.0 + 0.01 * wind_m_s**2)
    assert plant.rates_rad_s[0] - before == pytest.approx(push * (0.1 - 0.01), rel=0.03)


def test_throttle_arrives_late_by_what_is_not_the_links_nor_the_firmwares(frame):
    options, _ = firmware_options(stored(T_d_thrust=0.05))
    plant = build_motor_plant(options)
    began = None
    for k in range(200):
        plant.step([0.5] * 4, 0.00125)
        if began is None and plant.states["a_t_m_s2"] > 0.0:
            began = k * 0.00125
    assert began == pytest.approx(0.015, abs=0.0015)  # 50 ms less 30 of the link and 5 of the firmware


def test_what_the_firmware_does_itself_is_not_in_the_physics(frame):
    options, _ = firmware_options(stored(terms=("linear_drag", "angle_boost", "reference_shaping", "ground_effect")))
    assert options.model["terms"] == ["body", "linear_drag", "ground_effect"]
    json.loads(options.to_json())


def test_moments_of_the_air_are_in_the_physics(frame):
    options, _ = firmware_options(stored(terms=("linear_drag", "airflow_moment"), m_u=0.0, l_v=0.0, m_w=0.4, l_w=0.0))
    assert options.model["terms"] == ["body", "linear_drag", "airflow_moment"]
    plant = build_motor_plant(SimOptions.from_json(options.to_json()))
    turned = 0.0
    while plant.motion.on_ground or plant.motion.pz < 0.5:
        plant.step([1.3 * plant.hover_throttle] * 4, 0.00125)
        turned += 0.00125 * 0.4 * plant.motion.vz * np.sqrt(1.3)
    assert plant.rates_rad_s[1] == pytest.approx(turned, rel=0.02)
    assert plant.rates_rad_s[0] == pytest.approx(0.0, abs=1e-9)


def test_a_model_without_attitude_loops_does_not_fly_under_the_firmware():
    blind = ModelFile(Model(attitude_loops=False), {}, stored().values, (), np.zeros((0, 0)), {}, path="m")
    with pytest.raises(ModelError, match="has no attitude loops"):
        firmware_options(blind)


def test_a_saturated_mixer_turns_no_faster():
    loop = loop_of("roll", {})
    free, held = (simulate_loop(loop, 400.0, 0.01, np.full(80, 0.5), np.zeros(80), most)[1] for most in (1.0, 0.02))
    assert np.abs(held).max() <= 0.02 * 400.0 * 80 * LOOP_S + 1e-9
    assert np.abs(free).max() > np.abs(held).max()
    assert math.isfinite(free[-1])


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_the_firmware_s_own_parameters_are_those_of_yaw_rate_shaping(rate, monkeypatch):
    loop, model = loop_of("yaw", YAW_GAINS), Model(("yaw_rate_shaping",))
    values = model.start(
        {
            "shaping_yaw_accel": loop.accel,
            "shaping_yaw_hold": loop.angle_p,
            # gyro filter 9 ms, error filter 8, motors 5, output 2.5
            "shaping_yaw_lag": 0.025,
            "sigma_r": 80.0 * loop.rate_p,
        }
        | dict.fromkeys(("T_d", "T_d_attitude", "T_d_yaw_rate", "T_d_thrust"), 0.0)
    )
    t, rest = LOOP_S * np.arange(COUNT), (np.array([-1.0]), np.array([0.0]))
    u = dict.fromkeys(("roll_ref_rad", "pitch_ref_rad", "throttle"), rest)
    u["yaw_rate_ref_rad_s"] = np.array([-1.0, 0.0]), np.array([0.0, rate])
    volts = {"voltage_v": (t, np.full(COUNT, model.nominal_voltage_v))}
    said = np.asarray(simulate(model, values, t, {"p_z_m": 50.0}, u, volts)["r_rad_s"])

    def off():
        made = simulate_loop(loop, 80.0, 0.005, *firmware.demanded(rate, loop, COUNT))[1]
        return np.sqrt(np.mean((said - made) ** 2)) / rate

    assert off() < 0.012
    # A heading that trails the firmware's target slows it down.
    monkeypatch.setattr(firmware, "SentHeading", lambda yaw, accel, _lag: SentHeading(yaw, accel, 0.2))
    assert off() > 0.03
