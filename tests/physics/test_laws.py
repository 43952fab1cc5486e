"""Laws every term of the catalogue obeys, each against numbers written here without the term's own code."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from flighttest.channels import CHANNELS
from flighttest.frames import rotation_from_euler
from flighttest.physics import body
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Port, Signals

TERMS = catalogue()
FIXED_IDS = (
    "linear_drag",
    "quadratic_drag",
    "thrust_scaled_drag",
    "translational_lift",
    "axial_inflow",
    "vortex_ring",
    "ground_effect",
    "steady_wind",
    "airflow_moment",
    "slung_payload",
    "throttle_curve",
    "throttle_offset",
    "thrust_asymmetry",
    "rotor_speed_lag",
    "thrust_extra_lag",
    "thrust_fade",
    "angle_boost",
    "voltage_sag",
    "motor_saturation",
    "rate_limit",
    "reference_shaping",
    "attitude_extra_pole",
    "roll_pitch_coupling",
    "attitude_offset",
    "accelerometer_bias",
    "imu_lever_arm",
    "velocity_latency",
    "channel_delay",
)

VECTORS = ("rates", "angular_acceleration", "v_world", "v_dot_world", "v_air_body", "v_trimmed", "force")


def flight(**changes):
    """A vehicle climbing forward and left, tilted, turning, low above the ground: everything is doing something."""
    values = {
        "roll_ref": 0.3, "pitch_ref": -0.2, "yaw_rate_ref": 0.8, "throttle": 0.25, "target_roll": 0.3, "target_pitch": -0.2,
        "voltage": 23.0, "nominal_voltage": 22.2, "roll": 0.2, "pitch": -0.1, "yaw": 0.7, "roll_rate": 0.9, "pitch_rate": -0.6,
        "yaw_rate": 0.5, "rates": [0.9, -0.6, 0.5], "angular_acceleration": [4.0, -3.0, 1.0], "v_world": [2.0, 1.0, 0.5],
        "v_dot_world": [1.0, -2.0, 0.5], "v_air_body": [3.0, -2.0, -1.5], "height_m": 0.6, "rotor_height": 0.2, "time_s": 60.0, "a_t": 8.0,
        "a_t_total": 8.0, "command": 14.0, "sigma_t": 20.0, "a_t_dot": 120.0, "force": [0.4, -0.3, 8.0], "g": 9.81,
        "v_trimmed": [0.0, 0.0, 0.0],
    }  # fmt: skip
    return values | changes


def signals(values):
    s = Signals(**{k: ca.DM(v) if k in VECTORS else v for k, v in values.items()})
    s.rotation = ca.DM(rotation_from_euler([values["roll"], values["pitch"], values["yaw"]]))
    s.measured = {"f": ca.DM(values["force"]), "v": ca.DM(values["v_world"]), "roll": values["roll"],
                  "pitch": values["pitch"], "r": values["yaw_rate"]}  # fmt: skip
    s.base = {p.name: p.nominal for p in (*body.ATTITUDE_PARAMS, *body.THRUST_PARAMS)} | {"T_d_thrust": 0.1}
    return s


def params(term, **changes):
    off = {p.name: p.nominal if p.off is None else p.off for p in term.params}
    return {k: ca.DM(v) for k, v in (off | changes).items()}


def on(term):
    return {p.name: p.nominal for p in term.params}


def states(term, value=0.1):
    return {s.name: ca.DM(value) for s in term.states}


def flat(contribution):
    value = contribution.value
    parts = [value[k] for k in sorted(value)] if isinstance(value, dict) else [value]
    return np.concatenate([np.atleast_1d(np.array(ca.DM(v), dtype=float).ravel()) for v in parts])


def neutral(term, s):
    """What the port looks like without the term."""
    if term.port in (Port.MOTOR_GAIN, Port.AERO_GAIN):
        return np.ones(1)
    if term.port in (Port.WIND, Port.FORCE, Port.ANGULAR):
        return np.zeros(3)
    if term.port is Port.THRUST_LAG:
        return np.array([float(s.a_t_dot)])
    if term.port is Port.DELAY:
        return np.zeros(len(term.build(s, params(term), {}).value))
    names = sorted(term.build(s, params(term), states(term)).value)
    now = {k: s.measured[k] if term.port is Port.MEASUREMENT else getattr(s, k) for k in names}
    return np.concatenate([np.array(ca.DM(now[k]), dtype=float).ravel() for k in names])


@pytest.fixture(params=list(TERMS.values()), ids=list(TERMS))
def term(request):
    return request.param


def test_every_promised_id_is_there():
    assert set(FIXED_IDS) <= set(TERMS)


def test_declared_in_full(term):
    assert all([term.title, term.equation, term.source, term.doubt, term.told_apart_by, term.plain])
    assert term.family in ("aerodynamics", "propulsion", "payload", "autopilot", "sensor", "link")
    base = {p.name for p in (*body.ATTITUDE_PARAMS, *body.THRUST_PARAMS)} | {"T_d", "a_d"}
    others = {p.name for t in TERMS.values() if t is not term for p in t.params}
    assert set(term.hides_in) <= base | others | set(TERMS)
    assert set(term.needs) <= set(CHANNELS) | {"time_since_takeoff_s"}


def test_parameters_are_bounded_and_sourced(term):
    for p in term.params:
        assert all([p.unit, p.doc, p.source, p.symbol])
        assert p.scale > 0
        assert p.lower < p.nominal < p.upper or p.lower <= p.nominal <= p.upper
        if p.kind == "amplitude":
            assert p.off is not None
            assert p.lower < p.off <= p.upper
            assert p.nominal != p.off
        else:
            assert p.kind == "shape"
            assert p.off is None
            assert 1 <= len(p.screen) <= 5
            assert all(p.lower <= v <= p.upper for v in p.screen)


@pytest.mark.parametrize("term", [t for t in TERMS.values() if t.amplitudes], ids=lambda t: t.id)
def test_neutral_at_off_exactly(term):
    s = signals(flight())
    for shape in [{}, *({p.name: v} for p in term.shapes for v in p.screen)]:
        found = term.build(s, params(term, **shape), states(term))
        np.testing.assert_array_equal(flat(found), neutral(term, s))


def test_sensitivity_at_off_is_finite_and_not_zero(term):
    for amplitude in term.amplitudes:
        symbol = ca.SX.sym("amplitude")
        s, values = signals(flight()), params(term) | {amplitude.name: symbol}
        values = {k: v if k == amplitude.name else float(v) for k, v in values.items()}
        made = term.build(s, values, {k: float(v) for k, v in states(term).items()}).value
        parts = [made[k] for k in sorted(made)] if isinstance(made, dict) else [made]
        slope = ca.jacobian(ca.vertcat(*(ca.vec(ca.SX(x)) for x in parts)), symbol)
        found = np.array(ca.Function("slope", [symbol], [slope])(amplitude.off), dtype=float)
        assert np.isfinite(found).all(), amplitude.name
        assert np.abs(found).max() * amplitude.scale > 1e-5, amplitude.name


def test_symbolic_equals_numeric(term):
    s, p, x = signals(flight()), on(term), states(term)
    numeric = flat(term.build(s, {k: ca.DM(v) for k, v in p.items()}, x))
    names = [k for k, v in flight().items() if k not in VECTORS]
    symbols = {k: ca.SX.sym(k, 3) if k in VECTORS else ca.SX.sym(k) for k in flight()}
    sym = Signals(**symbols)
    sym.rotation, sym.measured, sym.base = s.rotation, s.measured, s.base
    sym.measured = {"f": symbols["force"], "v": symbols["v_world"], "roll": symbols["roll"], "pitch": symbols["pitch"],
                    "r": symbols["yaw_rate"]}  # fmt: skip
    q = {k: ca.SX.sym(k) for k in p}
    made = term.build(sym, q, x).value
    parts = [made[k] for k in sorted(made)] if isinstance(made, dict) else [made]
    out = ca.vertcat(*(ca.vec(ca.SX(v)) for v in parts))
    function = ca.Function("f", [*symbols.values(), *q.values()], [out])
    symbolic = np.array(function(*(ca.DM(v) for v in flight().values()), *p.values()), dtype=float).ravel()
    np.testing.assert_allclose(symbolic, numeric, rtol=1e-12, atol=1e-14)
    assert names


def test_finite_over_the_envelope(term):
    generator = np.random.default_rng(4)
    for _ in range(200):
        draw = generator.uniform
        values = flight(
            throttle=float(generator.choice([0.0, 1.0, draw(0, 1)])), voltage=draw(9, 26), roll=draw(-1.2, 1.2),
            pitch=draw(-1.2, 1.2), target_roll=draw(-1.4, 1.4), target_pitch=draw(-1.4, 1.4), roll_ref=draw(-1, 1),
            pitch_ref=draw(-1, 1), a_t=float(generator.choice([0.0, -0.5, draw(0, 60)])), command=draw(0, 60),
            height_m=float(generator.choice([-0.1, 0.0, draw(0, 100), 1e3])), time_s=draw(0, 2000),
            v_air_body=list(draw(-20, 20, 3)), rates=list(draw(-10, 10, 3)),
        )  # fmt: skip
        p = {q.name: ca.DM(draw(q.lower, q.upper)) for q in term.params}
        found = term.build(signals(values), p, {x.name: ca.DM(draw(-1, 1)) for x in term.states})
        assert np.isfinite(flat(found)).all(), values
        assert all(np.isfinite(float(v)) for v in found.state_rates.values())
        assert set(found.state_rates) == {x.name for x in term.states}


def test_reveals_a_shipped_maneuver(term, repository):
    assert (repository / "maneuvers" / f"{term.reveals}.yaml").is_file(), term.reveals


def strayed():
    """Rates of pitch and roll of a target that is to turn about the vertical and is turned by the rates ArduPilot makes of it: both as
    small rotations, in aerospace axes (x north, y east, z down)."""
    roll, pitch, yaw, q, r = 0.2, 0.1, -0.7, 0.6, -0.5  # of `flight`, from axes with z up
    turn = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    target, small = Rotation.from_euler("ZYX", [yaw, pitch, roll]), 1e-6
    taken = target.apply([0.0, 0.0, turn])  # ang_vel_target = attitude_desired_quat * ang_vel_body_rads
    after = (target * Rotation.from_rotvec(small * taken)).as_euler("ZYX")
    _, pitch_rate, roll_rate = (after - [yaw, pitch, roll]) / small
    return np.array([-pitch_rate, roll_rate])


def hub_moments():
    """Of `flight`, a rotation of scipy's instead of the product's; 0.1 m/s of each is trimmed. Thrust of 1.44 turns the rotors 1.2 times as
    fast, and advance ratio times thrust is as their speed."""
    body = Rotation.from_euler("ZYX", [0.7, -0.1, 0.2]).inv().apply([2.0, 1.0, 0.5])
    forward, left, up = 1.44 * body / 1.2 - [0.6, 0.3, 0.0]
    return [0.8 * left + 0.3 * up, 2.0 * up - 0.5 * forward, 0.0]


# Witnesses: the same physics in plain numbers. (term, what is set, changes to the flight, expected contribution).
WITNESSES = {
    "linear_drag": ({"d_x": 0.4, "d_y": 0.4, "d_z": 0.5}, {}, [-1.2, 0.8, 0.75]),
    "quadratic_drag": ({"k_x": 0.02, "k_y": 0.03, "k_z": 0.04}, {}, [-0.18, 0.12, 0.09]),
    "thrust_scaled_drag": ({"c_h": 0.05}, {}, [-1.2, 0.8, 0.0]),
    "translational_lift": ({"k_lift": 0.002}, {}, [1.026]),
    "axial_inflow": ({"k_inflow": 0.04}, {"a_t": 9.81 / 4}, [1 + 0.04 * 1.5 * 2]),
    "vortex_ring": ({"vortex_depth": 0.2, "vortex_centre": 1.5, "vortex_width": 1.0}, {}, [0.8]),
    # R = 0.4 m, rotor 0.8 m above the ground: (R / 4z)^2 = 1/64; the witness is Cheeseman and Bennett's own formula.
    "ground_effect": ({"R2_m2": 0.16}, {}, [64 / 63]),
    "steady_wind": ({"w_north": 3.0, "w_west": -1.0, "w_up": 0.2}, {}, [3.0, -1.0, 0.2]),
    # curvature 1: thrust goes with the square of throttle, K T (T / T_hover).
    "throttle_curve": ({"curvature": 1.0}, {}, [0.25 / (9.81 / 54.55)]),
    "throttle_offset": ({"T_min": 0.05}, {}, [0.8]),
    "motor_saturation": ({"T_max": 0.125}, {}, [0.5]),
    "thrust_asymmetry": ({"ln_sigma_ratio": 2 * np.log(2)}, {}, [240.0]),
    # w = sqrt(a): d/dt w^2 = 2 w sigma (sqrt(14) - w) against sigma (14 - a).
    "rotor_speed_lag": ({"rotor_lag": 1.0}, {}, [2 * np.sqrt(8) * 20 * (np.sqrt(14) - np.sqrt(8))]),
    "thrust_fade": ({"fade_depth": 0.1, "fade_tau": 60.0}, {}, [1 - 0.1 * (1 - np.exp(-1))]),
    # the lean angle of 0.1 s ago, that of the throttle which takes effect now
    "angle_boost": ({"boost": 1.0}, {"roll": 0.5, "pitch": 0.0, "roll_rate": 1.0, "pitch_rate": 0.0}, [0.25 / np.cos(0.4)]),
    "thrust_extra_lag": ({"thrust_extra_tau": 0.02}, {}, [0.0, 0.0, -0.1]),
    "voltage_sag": ({"sag_v": 3.0}, {}, [(22.7 / 23.0) ** 1.71]),
    "accelerometer_bias": ({"bias_x": 0.1, "bias_y": 0.2, "bias_z": -0.3}, {}, [0.5, -0.1, 7.7]),
    # w x r and centripetal for an arm ahead, turning about z alone: -w^2 r ahead, w_dot r to the left.
    "imu_lever_arm": ({"arm_x": 0.1}, {"rates": [0, 0, 2.0], "angular_acceleration": [0, 0, 5.0]}, [0.0, 0.2, 8.0]),
    "velocity_latency": ({"velocity_latency": 0.1}, {}, [1.99, 0.99, 0.49]),
    "attitude_offset": ({"offset_pitch": 0.1}, {}, [8 * np.sin(0.1), 0.0, 8 * (np.cos(0.1) - 1)]),
    "roll_pitch_coupling": ({"pitch_to_roll": 0.1, "roll_to_pitch": -0.2}, {}, [-0.26, 0.28]),
    # v_world in body axes by the rotation matrix of the attitude, less what is trimmed
    "airflow_moment": (
        {"m_u": 0.5, "l_v": 0.8, "m_w": 2.0, "l_w": 0.3}, {"v_trimmed": [0.5, 0.2, -0.1], "relative_thrust": 1.44}, hub_moments(),
    ),
    "channel_delay": ({"delay_attitude": 0.01, "delay_yaw_rate": 0.03}, {}, [0.01, 0.03]),
    # Far below the limit nothing; far above, the rate asked for is the limit: 2 zeta w (limit - wanted).
    "rate_limit": (
        {"rate_max": 1.0},
        {"roll_ref": 1.2, "roll": 0.2, "pitch_ref": -0.1, "pitch": -0.1},
        [2 * 0.44 * 25.43 * (1.0 - 25.43 / 0.88), 0.0, 0.0],
    ),
    # pitch_ref, roll_ref, target_pitch, target_roll: what the loop is given runs ahead of the target.
    "reference_shaping": ({"shaping_ff": 1.0}, {}, [0.1 * 2 * 0.39 / 23.4, 0.3 + 0.1 * 2 * 0.44 / 25.43, 0.0, 0.3]),
    # pitch_ref, roll_ref: what is 0.1 rad ahead of the angle, and 0.1 s times the rate at which it follows the reference in 15 ms
    "rate_feedforward": ({}, {}, [0.0 - 0.1 * 0.2 / 0.015, 0.3]),
    "yaw_rate_shaping": ({}, {}, [0.6]),
    "heading_hold": ({"heading_gain": 2.0}, {}, [0.0, 0.0, 21.54 * 2.0 * 0.1]),
    # r = cos(roll) cos(pitch) yaw_dot - sin(roll) pitch_dot, half of the way there
    "heading_rate_reference": ({"heading_rate_share": 0.5}, {}, [0.8 + 0.5 * (
        np.cos(0.2) * np.cos(-0.1) * 0.8 - np.sin(0.2) * (np.cos(0.2) * -0.6 - np.sin(0.2) * 0.5) - 0.8)]),
    "turn_axes": ({"turn_axes_s": 0.1}, {}, np.array([-0.2, 0.3]) + 0.1 * strayed()),
    "attitude_extra_pole": ({"attitude_pole_share": 0.5}, {}, [-0.1, 0.3]),
    # from the cable's constraint solved as one linear system for the load's acceleration and the tension
    "slung_payload": ({"payload_ratio": 0.25}, {"roll": 0.0, "pitch": 0.0, "yaw": 0.0}, [0.157816, 0.157816, -1.570268]),
}  # fmt: skip


def test_analytic_witness(term):
    assert term.id in WITNESSES, "add a witness for the new term"
    values, changes, expected = WITNESSES[term.id]
    found = flat(term.build(signals(flight(**changes)), params(term, **values), states(term)))
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-9)


def simulate(term_id, values, reference, duration_s, dt=0.001):
    """Integrate the states of an attitude term beside a roll angle that follows its target at once."""
    term = TERMS[term_id]
    s = signals(flight(roll=0.0, pitch=0.0, roll_rate=0.0, pitch_rate=0.0, roll_ref=reference, pitch_ref=0.0))
    x = states(term, 0.0)
    rates = compiled(term, params(term, **values), s, "roll_ref", x)
    at, out = np.array([float(value) for value in x.values()]), []
    for _ in range(int(duration_s / dt)):
        value, slope = rates(at)
        out.append(float(value))
        at = at + dt * slope.full().ravel()
    return np.array(out)


def test_a_reference_that_moves_is_led_by_its_rate_and_one_that_stands_is_not():
    term, reference, x = TERMS["rate_feedforward"], ca.SX.sym("reference"), states(TERMS["rate_feedforward"], 0.0)
    s = signals(flight(roll=0.0, pitch=0.0, roll_rate=0.0, pitch_rate=0.0, pitch_ref=0.0))
    s.roll_ref = reference
    rates = compiled(term, params(term, feedforward_s=0.2), s, "roll_ref", x, (reference,))
    at, dt, asked = np.zeros(len(x)), 0.001, np.append(0.5 * np.arange(0.0, 1.0, 0.001), np.full(500, 0.5))
    given = []
    for now in asked:
        value, slope = rates(at, now)
        given.append(float(value) - now)
        at = at + dt * slope.full().ravel()
    assert given[900] == pytest.approx((0.2 - 0.015) * 0.5, rel=1e-2)
    assert given[-1] == pytest.approx(0.0, abs=1e-6)


def compiled(term, values, given, channel, at, inputs=()):
    """The first component of what a term gives a channel, and the rates of its states, as a function of the states and the inputs."""
    x = {name: ca.SX.sym(name) for name in at}
    made = term.build(given, values, x)
    slopes = ca.vertcat(*(made.state_rates[name] for name in x))
    value = made.value[channel] if channel else 0.0
    return ca.Function("rates", [ca.vertcat(*x.values()), *inputs], [ca.SX(value)[0], slopes])


@pytest.mark.parametrize(("tau", "cycle"), [(0.2, 0.5), (0.2, 1.0), (0.2, 2.0), (0.1, 1.0)])
def test_a_late_velocity_is_that_of_so_long_ago(tau, cycle):
    term, dt = TERMS["velocity_latency"], 0.001
    omega, x, found = cycle / tau, states(TERMS["velocity_latency"], 0.0), []
    times = np.arange(0.0, 8 * np.pi / omega, dt)
    v, v_dot, s = ca.SX.sym("v"), ca.SX.sym("v_dot"), signals(flight())
    s.v_dot_world = ca.vertcat(v_dot, 0.0, 0.0)
    s.measured["v"] = ca.vertcat(v, 0.0, 0.0)
    rates = compiled(term, params(term, velocity_latency=tau), s, "v", x, (v, v_dot))
    at = np.array([float(value) for value in x.values()])
    for t in times:
        value, slope = rates(at, np.sin(omega * t), omega * np.cos(omega * t))
        found.append(float(value))
        at = at + dt * slope.full().ravel()
    settled = times > 4 * np.pi / omega
    error = np.array(found)[settled] - np.sin(omega * (times[settled] - tau))
    assert np.abs(error).max() < 0.04


def test_shaping_keeps_the_acceleration_limit_and_arrives():
    target = simulate("reference_shaping", {"shaping_accel": 10.0, "shaping_tc": 0.15, "shaping_ff": 0.0}, 0.5, 1.5)
    acceleration = np.gradient(np.gradient(target, 0.001), 0.001)
    assert np.abs(acceleration[5:-5]).max() < 10.0 * 1.05
    assert target[-1] == pytest.approx(0.5, abs=2e-3)
    # Bang-bang would take 2 sqrt(0.5 / 10) = 0.45 s; the square root keeps most of it, then decays with t_c.
    assert np.interp(0.9 * 0.5, target, np.arange(target.size) * 0.001) == pytest.approx(0.5, abs=0.12)


def test_the_throttle_may_be_boosted_by_the_targets_tilt():
    s = signals(flight(target_roll=0.5, target_pitch=0.0))
    made = TERMS["angle_boost"].build(s, params(TERMS["angle_boost"], boost=1.0, boost_actual=0.0), {})
    assert float(made.value["throttle"]) == pytest.approx(0.25 / np.cos(0.5))


def test_what_the_rate_loop_is_reported_beforehand_makes_the_second_order_follow_the_target():
    term, ahead = TERMS["reference_shaping"], {}
    s = signals(flight(roll=0.0, roll_rate=0.0))
    for share in (0.0, 1.0):
        x = states(term, 0.0) | {"roll_target_rate_rad_s": 0.7}
        ahead[share] = float(term.build(s, params(term, shaping_ff=share), x).value["roll_ref"])
    omega, zeta = s.base["omega_phi"], s.base["zeta_phi"]
    assert ahead[1.0] - ahead[0.0] == pytest.approx(2 * zeta / omega * 0.7)


def autopilots_own(reference, acceleration, tc, duration_s, dt=0.0025):
    """The target as ArduPilot moves it, one loop of 400 Hz after the other."""
    angle, rate, out = 0.0, 0.0, []
    for _ in range(int(duration_s / dt)):
        error, linear = reference - angle, acceleration * tc**2
        far = np.copysign(np.sqrt(2 * acceleration * max(abs(error) - linear / 2, 0.0)), error)
        wanted = error / tc if abs(error) <= linear else far
        rate += np.clip(wanted - rate, -acceleration * dt, acceleration * dt)
        angle += rate * dt
        out.append(angle)
    return np.array(out)


@pytest.mark.parametrize("acceleration", [6.4, 19.2])
def test_the_shaped_target_is_the_autopilots_own(acceleration):
    values = {"shaping_accel": acceleration, "shaping_tc": 0.15, "shaping_ff": 0.0}
    ours = simulate("reference_shaping", values, 0.5, 0.8, dt=0.0005)[4::5]
    assert np.abs(ours - autopilots_own(0.5, acceleration, 0.15, 0.8)).max() < 0.008


def test_a_small_step_is_shaped_linearly():
    small = simulate("reference_shaping", {"shaping_accel": 20.0, "shaping_tc": 0.15, "shaping_ff": 0.0}, 0.05, 0.6)
    large = simulate("reference_shaping", {"shaping_accel": 20.0, "shaping_tc": 0.15, "shaping_ff": 0.0}, 0.10, 0.6)
    assert np.abs(2 * small - large).max() < 0.006


@pytest.mark.parametrize("swing_rad", [0.1, 1.2, 1.5])
def test_pendulum_swings_at_its_own_period(swing_rad):
    """Also where the cable is nearly level: the period of a large swing is an elliptic integral."""
    term = TERMS["slung_payload"]
    x = {k: ca.DM(0.0) for k in states(term)} | {"swing_west": ca.DM(2 * np.tan(swing_rad / 2))}
    p = params(term, payload_ratio=1e-9, cable_m=1.0, swing_damping=0.0)
    hover = signals(flight(roll=0.0, pitch=0.0, yaw=0.0, force=[0.0, 0.0, 9.81]))
    rates, at = compiled(term, p, hover, "", x), {name: float(value) for name, value in x.items()}
    swing = []
    for _ in range(4000):
        slopes = dict(zip(at, rates(list(at.values()))[1].full().ravel(), strict=True))
        at["swing_west_rate_1_s"] += 0.001 * slopes["swing_west_rate_1_s"]
        at["swing_west"] += 0.001 * at["swing_west_rate_1_s"]
        swing.append(at["swing_west"])
    crossings = np.flatnonzero(np.diff(np.sign(swing)))
    period = 4 * ellipk(np.sin(swing_rad / 2) ** 2) / np.sqrt(9.81)
    assert 2 * np.diff(crossings).mean() * 0.001 == pytest.approx(period, rel=0.003)
