"""The two airframes against witnesses that do not use them: hover, terminal velocity, closed forms, and every switch."""

import math
from itertools import pairwise

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.frames import flip_vector
from flighttest.sim.build import build_plant
from flighttest.sim.hidden_values import check_values
from flighttest.sim.options import SimOptions
from flighttest.sim.plants.battery import Battery, cell_voltage, charge_at
from flighttest.sim.plants.plant import Command
from flighttest.sim.plants.plant_paper import PaperParameters, PaperPlant
from flighttest.sim.plants.rotor_effects import EFFECTS, effects_on
from flighttest.sim.plants.rotor_vehicle import RotorVehicle, random_rotor
from flighttest.sim.sensors import LowPass3

G = 9.81
FOREVER = {"capacity_ah": 1e6}


def _plant(airframe, hide=None, **options):
    return build_plant(SimOptions(airframe=airframe, hide=hide or {}, **FOREVER, **options))


def _fly(plant, pieces, dt=0.005):
    """Fly (seconds, roll, pitch, yaw rate, throttle) pieces; rows of v, roll, pitch, yaw, p, q, r, f, voltage."""
    rows, command = [], Command(spinning=True)
    for seconds, command.roll, command.pitch, command.yaw_rate, command.throttle in pieces:
        for _ in range(round(seconds / dt)):
            plant.advance(dt, command)
            m = plant.motion
            rows.append([m.vx, m.vy, m.vz, m.roll, m.pitch, m.yaw, m.p, m.q, m.r, m.fx, m.fy, m.fz, m.voltage])
    return np.array(rows)


def _tour(plant):
    """Something of everything: climb, low flight, tilts both ways at two throttles, turn, drop, catch."""
    h = plant.hover_throttle
    return _fly(
        plant,
        [
            (0.8, 0, 0, 0, 1.5 * h), (1.0, 0.3, 0, 0, 1.05 * h), (1.0, -0.3, 0.1, 0, 1.2 * h), (1.2, 0, 0.4, 0, 1.05 * h),
            (0.8, 0, -0.4, 0, h), (0.8, 0, 0, 2.0, 1.2 * h), (0.9, 0, 0, 0, 0.5 * h), (0.8, 0, 0, 0, 2.1 * h),
        ],
    )  # fmt: skip


@pytest.mark.parametrize("airframe", ["paper", "rotor"])
def test_hover_throttle_carries_the_weight(airframe):
    plant = _plant(airframe)
    h = plant.hover_throttle
    _fly(plant, [(1.0, 0, 0, 0, 1.3 * h), (6.0, 0, 0, 0, h)])
    # what is left of the climb decays with d_z; a small sag under load makes it sink a little
    assert abs(plant.motion.vz) < 0.35
    assert plant.motion.fz == pytest.approx(G, abs=0.15)


def test_paper_terminal_velocity_and_thrust_are_eq_4():
    p = PaperParameters()
    plant = PaperPlant(p, Battery(capacity_ah=1e6, resistance_ohm=0.0))
    throttle = 1.2 * plant.hover_throttle
    rows = _fly(plant, [(15.0, 0, 0, 0, throttle)])
    gain = p.K * (25.2 / 22.2) ** p.alpha
    assert rows[-1, 2] == pytest.approx((gain * throttle - G) / p.d_z, rel=1e-3)


def test_paper_step_responses_are_the_closed_forms():
    p = PaperParameters()
    plant = PaperPlant(p, Battery(capacity_ah=1e6, resistance_ohm=0.0))
    h = plant.hover_throttle
    _fly(plant, [(0.6, 0, 0, 0, 1.5 * h)])
    rows = _fly(plant, [(0.4, 0.3, 0, 1.0, 1.5 * h)])
    t = 0.005 * np.arange(1, len(rows) + 1)
    w, z = p.omega_phi, p.zeta_phi
    wd = w * math.sqrt(1 - z * z)
    roll = 0.3 * (1 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t)))
    assert np.abs(rows[:, 3] - roll).max() < 1e-5
    assert np.abs(rows[:, 8] - (1 - np.exp(-p.sigma_r * t))).max() < 1e-5


def test_edges_inside_a_tick_are_exact():
    def flown(cut):
        plant = PaperPlant(battery=Battery(capacity_ah=1e6, resistance_ohm=0.0))
        h = plant.hover_throttle
        _fly(plant, [(0.6, 0, 0, 0, 1.5 * h)])
        before, after = Command(0, 0, 0, h, True), Command(0.3, 0, 0, h, True)
        for dt, command in cut(before, after):
            plant.advance(dt, command)
        return plant.motion.roll

    fine = flown(lambda b, a: [(0.0013, b), *[(0.0001, a)] * 987])
    coarse = flown(lambda b, a: [(0.0013, b), (0.0037, a), *[(0.005, a)] * 19])
    assert coarse == pytest.approx(fine, abs=2e-6)


def test_the_hubs_tilt_a_rotor_vehicle_against_its_speed():
    """In steady flight the loop, without an integrator, yields by moment over stiffness: u M_u / omega^2 in pitch, v L_v / omega^2 in
    roll."""
    v = RotorVehicle()
    plant = _plant("rotor", {"airflow_moment": {"m_u": 2.0, "l_v": 1.5}})
    h = plant.hover_throttle
    rows = _fly(plant, [(0.8, 0, 0, 0, 1.4 * h), (12.0, -0.1, 0.1, 0, 1.01 * h)])
    vx, vy, _, roll, pitch = rows[-1, :5]
    assert pitch - 0.1 == pytest.approx(-2.0 * vx / v.omega_pitch**2, rel=0.06)
    assert roll + 0.1 == pytest.approx(1.5 * vy / v.omega_roll**2, rel=0.06)
    assert pitch < 0.09


def test_the_rotor_is_second_order_and_linear_enough():
    v = RotorVehicle()
    plant = _plant("rotor")
    h = plant.hover_throttle
    _fly(plant, [(0.8, 0, 0, 0, 1.4 * h)])
    roll = _fly(plant, [(0.8, 0.3, 0, 0, 1.1 * h)])[:, 3]
    t = 0.005 * np.arange(1, roll.size + 1)

    def model(w, z, delay):
        s = np.clip(t - delay, 0, None)
        wd = w * math.sqrt(1 - z * z)
        return 0.3 * (1 - np.exp(-z * w * s) * (np.cos(wd * s) + z * w / wd * np.sin(wd * s)))

    from scipy.optimize import least_squares

    fit = least_squares(lambda x: model(*x) - roll, [v.omega_roll, v.zeta_roll, 0.004])
    assert np.sqrt(np.mean(fit.fun**2)) < 2e-4  # far below what an attitude estimate can see
    assert fit.x[0] == pytest.approx(v.omega_roll, rel=0.08)
    assert fit.x[2] < 0.01


def test_the_rotor_answers_every_seed_and_stays_upright():
    for seed in range(12):
        plant = _plant("rotor", vehicle_seed=seed)
        v = plant.vehicle
        assert 1.0 <= v.mass_kg <= 7.0
        rows = _tour(plant)
        assert np.isfinite(rows).all()
        assert np.abs(rows[:, 3:5]).max() < 0.6
        assert plant.motion.pz > 0.0
    assert random_rotor(1) == random_rotor(1) != random_rotor(2)


CHANGES = dict.fromkeys(EFFECTS, "motion") | {"gust_front": None}
SETTINGS = {
    "motor_saturation": {"T_max": 0.25}, "linear_drag": {"d_x": 0.6, "d_y": 0.6, "d_z": 0.6},
    "gust_front": {"from_s": 1.0}, "updraft": {}, "tether": {"rest_m": 0.5}, "vortex_ring": {"vortex_centre": 2.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def clean_tours():
    return {airframe: _tour(_plant(airframe)) for airframe in ("paper", "rotor")}


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_of_the_rotor_changes_what_is_measured(name, clean_tours):
    plant = _plant("rotor", {name: SETTINGS.get(name, {})})
    if name == "channel_delay":  # acts before the plant
        clean = _plant("rotor").delays
        assert plant.delays.attitude_s - clean.attitude_s == pytest.approx(0.03)
        return
    if name == "attitude_priority":  # a rotor stops only where a hard tilt meets little throttle
        clean, h = _plant("rotor"), plant.hover_throttle
        hard = [(0.8, 0, 0, 0, 1.5 * h), (0.4, 0.5, 0, 0, 0.3 * h), (0.4, -0.5, 0, 0, 0.3 * h)]
        assert np.abs(_fly(plant, hard) - _fly(clean, hard)).max() > 0.02
        return
    change = np.abs(_tour(plant) - clean_tours["rotor"])
    assert np.isfinite(change).all()
    assert change.max() > 0.02


@pytest.mark.slow
def test_every_catalogue_term_changes_the_paper_vehicle(clean_tours):
    from flighttest.physics.catalogue import catalogue

    for name in sorted(set(catalogue()) - {"channel_delay"}):
        plant = _plant("paper", {name: {"d_x": 0.6} if name == "linear_drag" else {}})
        change = np.abs(_tour(plant) - clean_tours["paper"])
        assert np.isfinite(change).all(), name
        if name != "motor_saturation":  # nominal T_max is not reached here
            assert change.max() > 0.01, name
    late = _plant("paper", {"channel_delay": {"delay_attitude": 0.03}})
    assert late.delays.attitude_s == pytest.approx(0.13)
    assert late.delays.thrust_s == pytest.approx(0.1)


def test_terms_at_nothing_are_the_plain_paper_vehicle(clean_tours):
    zero = {"steady_wind": {"w_north": 0.0, "w_west": 0.0, "w_up": 0.0}}
    # two integrators of the same equations, one in plain numbers, one composed by physics
    assert np.abs(_tour(_plant("paper", zero)) - clean_tours["paper"]).max() < 1e-6


def test_magnitudes_mean_what_they_say():
    h = RotorVehicle().hover_throttle
    wind = _plant("rotor", {"steady_wind": {"w_north": 3.0, "w_west": 0.0}})
    _fly(wind, [(0.8, 0, 0, 0, 1.5 * wind.hover_throttle), (14.0, 0, 0, 0, 1.0 * wind.hover_throttle)])
    assert wind.motion.vx == pytest.approx(3.0, abs=0.1)  # it drifts with the air
    biased = _plant("rotor", {"accelerometer_bias": {"bias_x": 0.4, "bias_y": 0.0, "bias_z": 0.0}})
    _fly(biased, [(0.01, 0, 0, 0, 0)])
    assert (biased.motion.fx, biased.motion.fz) == pytest.approx((0.4, G))
    offset = _plant("rotor", {"attitude_offset": {"offset_roll": 0.02, "offset_pitch": 0.0}})
    _fly(offset, [(0.8, 0, 0, 0, 1.5 * h), (3.0, 0, 0, 0, 1.05 * h)])
    assert offset.motion.roll == pytest.approx(0.0, abs=1e-3)  # reported level ...
    assert offset.motion.vy < -0.3  # ... while the thrust axis leans right
    load = _plant("rotor", {"slung_payload": {"payload_ratio": 0.2}})
    heavy = load.hover_throttle * 1.2
    _fly(load, [(0.8, 0, 0, 0, 1.4 * heavy), (5.0, 0, 0, 0, heavy)])
    assert load.motion.fz == pytest.approx(G, abs=0.2)
    low, high = _plant("rotor", {"ground_effect": {"R2_m2": 0.3}}), _plant("rotor")
    _fly(low, [(0.25, 0, 0, 0, 1.1 * h)])
    _fly(high, [(0.25, 0, 0, 0, 1.1 * h)])
    z = RotorVehicle().rotor_height_m
    assert low.rotor_thrust_n == pytest.approx(high.rotor_thrust_n)  # the rotors turn alike, the air does the rest
    assert low.motion.pz > high.motion.pz
    assert 1.0 / (1.0 - 0.3 / 16.0 / z**2) > 1.3


def test_landing_stops_and_a_hard_one_stays_down():
    for airframe in ("paper", "rotor"):
        plant = _plant(airframe)
        h = plant.hover_throttle
        _fly(plant, [(1.0, 0, 0, 0, 1.2 * h), (4.0, 0, 0, 0, 0.9 * h)])
        assert plant.motion.on_ground
        assert plant.motion.fz == pytest.approx(G)
        _fly(plant, [(1.0, 0, 0, 0, 1.3 * h)])
        assert not plant.motion.on_ground
        _fly(plant, [(2.0, 0, 0, 0, 1.5 * h), (4.0, 0, 0, 0, 0.0)])
        assert plant.motion.impact_m_s > 4.0
        _fly(plant, [(1.0, 0, 0, 0, 2.0 * h)])
        assert plant.motion.on_ground


def test_thrust_follows_a_sagging_battery_without_the_step_being_seen():
    def final(dt):
        plant = PaperPlant(battery=Battery(resistance_ohm=0.05))
        _fly(plant, [(0.5, 0, 0, 0, 1.2 * plant.hover_throttle)])
        for _ in range(round(0.06 / dt)):
            plant.advance(dt, Command(0, 0, 0, 2.0 * plant.hover_throttle, True))
        return plant.motion.fz

    assert final(0.005) == pytest.approx(final(0.0005), rel=4e-4)


def test_battery_sags_drains_and_is_replaced():
    b = Battery(capacity_ah=5.0, resistance_ohm=0.01)
    assert b.voltage == pytest.approx(25.2)
    b.draw(50.0, 36.0)
    assert b.used_ah == pytest.approx(0.5)
    assert b.voltage == pytest.approx(6 * cell_voltage(0.9) - 0.5)
    levels = [cell_voltage(c / 50) for c in range(51)]
    assert all(low < high for low, high in pairwise(levels))
    b.replace(23.1)
    assert b.voltage == pytest.approx(23.1)
    assert charge_at(cell_voltage(0.37)) == pytest.approx(0.37)


def test_low_pass_is_the_continuous_butterworth_whatever_the_tick():
    w = math.tau * 20.0
    for dt in (0.005, 0.0025):
        f, amplitude, found = LowPass3(20.0, dt), 30.0, []
        for k in range(1, round(1.0 / dt) + 1):
            f.update(math.sin(amplitude * k * dt), 0.0, 1.0)
            found.append(f.x)
        s = 1j * amplitude
        h = w * w / (s * s + math.sqrt(2.0) * w * s + w * w)
        t = dt * np.arange(1, len(found) + 1)
        exact = np.abs(h) * np.sin(amplitude * t + np.angle(h))
        assert np.abs(np.array(found) - exact)[t > 0.3].max() < 2e-3
        assert f.z == pytest.approx(1.0, abs=1e-3)


def test_telemetry_signs_are_those_of_frames(bare):
    c = bare.Client(**bare.QUIET)
    c.airborne()
    m = c.motion
    m.vx, m.vy, m.vz = 1.0, 2.0, 3.0
    c.command(512, 32)
    p = c.last("LOCAL_POSITION_NED")
    assert (p.vx, p.vy, p.vz) == pytest.approx(tuple(flip_vector([1.0, 2.0, 3.0])))


@pytest.mark.parametrize("name", EFFECTS)
def test_the_usual_values_of_an_effect_can_be(name):
    check_values({name: effects_on({name: {}}, RotorVehicle())[name]})


def test_values_at_the_end_of_what_physics_allows_are_flown():
    check_values({"linear_drag": {"d_x": 0.0}, "ground_effect": {"R2_m2": 8.0}, "steady_wind": {"w_north": -5.0}})
    beyond = (("linear_drag", "d_x", -1e-9), ("ground_effect", "R2_m2", 8.001), ("steady_wind", "w_up", -3.1))
    for name, key, value in beyond:
        with pytest.raises(InputError, match="cannot be"):
            check_values({name: {key: value}})
