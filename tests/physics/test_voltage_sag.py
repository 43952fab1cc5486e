"""A pack behind a monitor that lags, written out again: the term has what the logged voltage does not show, and when."""

import numpy as np
from scipy.integrate import solve_ivp

from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate

FULL_SAG_V, MONITOR_S = 3.0, 0.4


def flown(values, t_s):
    """Thrust over mass (n,) and logged voltage (n,) of throttle steps 0.18, 0.35, 0.2. The voltage drops with the motors' load and acts on
    the thrust at once."""

    def throttle(t):
        return 0.18 if t < 0.1 else 0.35 if t < 1.1 else 0.2

    def rate(t, x):
        ramp, logged = x
        drop = FULL_SAG_V * max(ramp, 0.0) ** 1.5
        return [values["sigma_t"] * (throttle(t) - ramp), (drop - logged) / MONITOR_S]

    found = solve_ivp(rate, (0.0, t_s[-1]), [0.18, FULL_SAG_V * 0.18**1.5], t_eval=t_s, max_step=1e-3, rtol=1e-9)
    ramp, logged = found.y
    acting = 22.2 - FULL_SAG_V * ramp**1.5
    return values["K"] * ramp * (acting / 22.2) ** values["alpha"], 22.2 - logged


def test_what_the_log_does_not_show_yet_acts_with_the_thrust():
    model = Model(("voltage_sag",), channel_delays=False)
    values = {**model.start(), "T_d": 0.0, "sag_v": FULL_SAG_V, "sag_tau": MONITOR_S}
    t_s = np.arange(0.0, 2.1, 0.005)
    thrust, voltage = flown(values, t_s)
    columns = {"throttle": (np.array([-1.0, 0.1, 1.1]), np.array([0.18, 0.35, 0.2]))}
    start, logged = {"p_z_m": 5.0, "a_t_m_s2": thrust[0]}, {"voltage_v": (t_s, voltage)}
    error = {}
    for sag in (0.0, FULL_SAG_V):
        found = simulate(model, {**values, "sag_v": sag}, t_s, start, columns, logged)
        error[sag] = np.sqrt(np.mean((found["f_z_m_s2"] - thrust) ** 2))
    assert error[FULL_SAG_V] < 0.12 * error[0.0]  # 0.48 where the drop comes through the motors' lag
