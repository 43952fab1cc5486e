"""Terms compose into blocks and into the chained system; both against closed forms."""

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flighttest.errors import ModelError
from flighttest.frames import rotation_from_euler
from flighttest.physics.catalogue import catalogue
from flighttest.physics.core import Contribution, Param, Port, Term
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate


def term(term_id, port, build, params=(), states=()):
    return Term(
        term_id,
        term_id,
        "aerodynamics",
        port,
        tuple(params),
        build,
        "",
        "",
        "",
        "",
        (),
        "",
        "roll_pitch",
        (),
        tuple(states),
    )


def amplitude(name, upper=10.0):
    return Param(name, name, "1", 0.0, -upper, upper, 1.0, "", "")


def test_the_papers_model_has_its_twelve_parameters_and_four_independent_blocks():
    single = Model(channel_delays=False)
    assert set(single.names) == {
        "omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r", "sigma_t", "K", "alpha", "d_x", "d_y", "d_z", "T_d",
    }  # fmt: skip
    assert [b.name for b in Model().blocks] == ["roll", "pitch", "yaw", "translation"]
    assert Model(("body",)).names == tuple(n for n in Model().names if not n.startswith("d_"))


def test_a_coupling_term_joins_roll_and_pitch():
    coupled = term("pair", Port.ANGULAR, lambda s, p, x: Contribution((p["k"] * s.pitch_rate, 0, 0)), [amplitude("k")])
    model = Model().with_terms(coupled)
    assert [b.name for b in model.blocks] == ["roll_pitch", "yaw", "translation"]
    assert "k" in model.blocks[0].params


def test_thrust_is_boosted_by_the_target_and_not_by_what_the_loop_is_reported_beforehand():
    model = Model(("reference_shaping", "angle_boost"))
    system, values = model.system, model.start({"boost": 1.0, "boost_actual": 0.0, "shaping_ff": 1.0})
    state = {"roll_target_ahead_rad": 0.2, "roll_target_rate_rad_s": 2.0}
    x = [state.get(n, 0.0) for n in system.states]
    u = [{"throttle": 0.2, "voltage_v": 22.2, "roll_ref_rad": 0.5}.get(n, 0.0) for n in system.inputs]
    x_dot, _ = system.function(x, u, [values[n] for n in model.names])
    rate = float(x_dot[list(system.states).index("a_t_m_s2")])
    assert rate == pytest.approx(values["sigma_t"] * values["K"] * 0.2 / np.cos(0.2), rel=1e-6)


def test_without_attitude_loops_the_attitude_is_an_input():
    model = Model(attitude_loops=False)
    assert "omega_phi" not in model.names
    assert [b.name for b in model.blocks] == ["translation"]
    assert {"roll_rad", "pitch_rad", "yaw_rad"} <= set(model.system.inputs)
    assert "roll_rad" not in model.system.states


def test_a_lever_arm_needs_the_angular_acceleration_that_no_loop_shows():
    model = Model(("imu_lever_arm",), attitude_loops=False)
    inputs = list(model.system.inputs)
    assert "r_dot_rad_s2" in inputs
    assert "r_dot_rad_s2" not in Model(attitude_loops=False).system.inputs
    values = model.start({"arm_x": 0.1})
    u = [{"voltage_v": 22.2, "r_dot_rad_s2": 5.0}.get(n, 0.0) for n in inputs]
    _, y = model.system.function(np.zeros(len(model.system.states)), u, [values[n] for n in model.names])
    assert float(y[list(model.system.outputs).index("f_y_m_s2")]) == pytest.approx(0.5)


def test_the_order_of_ports_is_kept():
    """Motor gain acts before the lag, aero gain after it; the force term sees the product of both."""
    seen = {}

    def force(s, p, x):
        seen["a"] = s.a_t_total
        return Contribution(ca.vertcat(0, 0, p["f"] * s.a_t_total))

    model = Model(("body",)).with_terms(
        term("gain", Port.AERO_GAIN, lambda s, p, x: Contribution(1 + p["ga"]), [amplitude("ga")]),
        term("motor", Port.MOTOR_GAIN, lambda s, p, x: Contribution(1 + p["gm"]), [amplitude("gm")]),
        term("extra", Port.FORCE, force, [amplitude("f")]),
    )
    block = model.blocks[-1]
    p = {**model.start(), "ga": 0.5, "gm": 0.25, "f": 0.1, "K": 40.0, "alpha": 0.0}
    x = [0, 0, 0, 8.0]
    e = {"voltage_v": 22.2}
    x_dot, y = block.function(
        x, [p[n] for n in block.params], [0.2], [e.get(n, 0.0) for n in block.exogenous], [0, 0, 0]
    )
    assert float(y[2]) == pytest.approx(8.0 * 1.5 * 1.1)
    assert float(x_dot[3]) == pytest.approx(p["sigma_t"] * (40.0 * 0.2 * 1.25 - 8.0))


def test_a_term_that_names_keys_of_both_blocks_is_refused():
    both = term("both", Port.REFERENCE, lambda s, p, x: Contribution({"roll_ref": s.roll_ref, "throttle": s.throttle}))
    with pytest.raises(ModelError, match="both contributes"):
        _ = Model().with_terms(both).blocks


def test_unknown_terms_and_shared_names_are_errors_with_a_remedy():
    with pytest.raises(ModelError, match="did you mean 'linear_drag'"):
        Model(("body", "linear_darg"))
    with pytest.raises(ModelError, match="share the names"):
        Model().with_terms(term("again", Port.FORCE, lambda s, p, x: Contribution((0, 0, 0)), [amplitude("d_x")]))


def test_one_delay_serves_all_channels_until_a_term_parts_them():
    late = term("late", Port.DELAY, lambda s, p, x: Contribution({"thrust": p["extra"]}), [amplitude("extra")])
    model = Model(channel_delays=False).with_terms(late)
    values = {**model.start({"T_d": 0.08}), "extra": 0.02}
    delays = np.asarray(model.system.delays_s([values[n] for n in model.system.params])).ravel()
    assert dict(zip(model.system.delay_channels, delays, strict=True)) == pytest.approx(
        {"attitude": 0.08, "yaw_rate": 0.08, "thrust": 0.10}
    )


def test_start_values_pass_between_one_delay_and_the_channels_own():
    assert Model().start({"T_d": 0.2})["T_d_thrust"] == 0.2
    single = Model(channel_delays=False).start({"T_d_attitude": 0.1, "T_d_thrust": 0.2, "T_d_yaw_rate": 0.3})
    assert single["T_d"] == pytest.approx(0.2)


def test_every_catalogue_term_composes_alone():
    for name in catalogue():
        model = Model(("body", "linear_drag", name))
        assert model.blocks
        assert model.system.function.size1_out(0) == len(model.system.states)


def eq4(values, refs, voltage, t_end, x0, times):
    """Eq. 4 written out again, integrated tightly between the delayed edges."""
    w, z = (values["omega_phi"], values["omega_theta"]), (values["zeta_phi"], values["zeta_theta"])
    drag = np.diag([values["d_x"], values["d_y"], values["d_z"]])

    def rate(t, x, u):
        v, a_t = x[3:6], x[12]
        phi, phi_d, theta, theta_d, r, psi = x[6:12]
        rot = rotation_from_euler([phi, theta, psi])
        acc = rot @ np.array([0, 0, a_t]) - rot @ drag @ rot.T @ v - np.array([0, 0, 9.81])
        return np.concatenate([v, acc, [
            phi_d, w[0] ** 2 * (u[0] - phi) - 2 * z[0] * w[0] * phi_d,
            theta_d, w[1] ** 2 * (u[1] - theta) - 2 * z[1] * w[1] * theta_d,
            values["sigma_r"] * (u[2] - r),
            (r / np.cos(phi) + np.tan(phi) * theta_d) / np.cos(theta),
            values["sigma_t"] * (values["K"] * (voltage / 22.2) ** values["alpha"] * u[3] - a_t),
        ]])  # fmt: skip

    edges = sorted({0.0, t_end, *(at + values["T_d"] for at in refs if 0 < at + values["T_d"] < t_end)})
    x, rows = np.array(x0, dtype=float), []
    for a, b in pairwise(edges):
        u = next(refs[at] for at in sorted(refs, reverse=True) if at + values["T_d"] <= a + 1e-9)
        inside = times[(times >= a) & (times < b)]
        made = solve_ivp(rate, (a, b), x, args=(u,), rtol=1e-10, atol=1e-12, t_eval=np.append(inside, b))
        rows.append(made.y[:, : inside.size])
        x = made.y[:, -1]
    return np.concatenate(rows, axis=1).T


def test_the_chained_system_is_equation_4():
    model = Model(channel_delays=False)
    values = {**model.start(), "T_d": 0.0137}
    refs = {-9.0: (0.0, 0.0, 0.0, 0.18), 0.1: (0.3, -0.2, 1.0, 0.25), 0.731: (-0.3, 0.3, -1.0, 0.12)}
    times = np.arange(0.0, 1.6, 0.02)
    exact = eq4(values, refs, 23.4, 1.7, [0, 0, 5, 1, -2, 0.5, 0, 0, 0, 0, 0, 0.7, 9.0], times)
    at = np.array(list(refs))
    names = ("roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle")
    columns = {n: (at, np.array([u[i] for u in refs.values()])) for i, n in enumerate(names)}
    start = {"p_z_m": 5.0, "v_x_m_s": 1.0, "v_y_m_s": -2.0, "v_z_m_s": 0.5, "yaw_rad": 0.7, "a_t_m_s2": 9.0}
    ours = simulate(model, values, times, start, columns, {"voltage_v": (times[:1], np.array([23.4]))})
    for i, name in enumerate(model.system.states):
        size = max(1.0, np.abs(exact[:, i]).max())
        assert np.allclose(ours[name], exact[:, i], atol=5e-5 * size), name
    tilt = rotation_from_euler(np.stack([exact[:, 6], exact[:, 8], exact[:, 11]], axis=1))
    force = np.array([ours["f_x_m_s2"], ours["f_y_m_s2"], ours["f_z_m_s2"]]).T
    world = np.einsum("kij,kj->ki", tilt, force) - [0, 0, 9.81]
    assert np.allclose(world[:, 2], ours["a_z_m_s2"], atol=1e-3)


def test_hover_stays():
    model = Model()
    values = model.start()
    hover = 9.81 / values["K"]
    z = np.array([-1.0])
    columns = {"throttle": (z, np.array([hover])), "roll_ref_rad": (z, np.array([0.0]))}
    times = np.linspace(0, 2, 101)
    ours = simulate(model, values, times, {"p_z_m": 3.0}, columns, {"voltage_v": (z, np.array([22.2]))})
    assert np.allclose(ours["p_z_m"], 3.0, atol=1e-9)
    assert np.allclose(ours["f_z_m_s2"], 9.81)
