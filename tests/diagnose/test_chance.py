"""How sure rows make us, where the answer is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from flighttest.diagnose.chance import consistency, plain, standard_errors, standard_errors_of_equations
from made_rows import rows_of

from flighttest.diagnose.findings import parameter_table
from flighttest.physics.model import Model


def told_by(channel, columns, y, names):
    """Rows at the optimum of y (n,), and the standard errors: by scatter alone, and with what parts disagree on."""
    rows = rows_of(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0], columns, segments=40, channel=channel)
    return standard_errors(rows, names), standard_errors_of_equations(rows, names)


def test_instruments_that_disagree_widen_an_interval_that_responses_would_leave_narrow(rng):
    n = 4000
    channel, column = np.tile([0, 1], n // 2), np.ones((n, 1))
    noise = 0.1 * rng.normal(size=n)
    scatter, wide = told_by(channel, column, noise, ("p0",))
    assert wide[0] < 2 * scatter[0]
    scatter, wide = told_by(channel, column, noise + np.where(channel == 0, 0.05, -0.05), ("p0",))
    assert scatter[0] < 0.005
    assert wide[0] == pytest.approx(0.05, rel=0.15)  # each channel alone is half of the data, 0.05 away


@pytest.mark.parametrize("share", [0.5, 0.7, 0.89, 0.97])
def test_noise_alone_widens_little_however_unevenly_parts_tell(rng, share):
    n, ratios = 2000, []
    channel = np.tile([0, 1], n // 2)
    column = np.where(channel == 0, np.sqrt(share), np.sqrt(1 - share))[:, None]
    for _ in range(60):
        scatter, wide = told_by(channel, column, rng.normal(size=n), ("p0",))
        ratios.append(wide[0] / scatter[0])
    assert np.sqrt(np.mean(np.square(ratios))) < 1.7


@pytest.mark.parametrize("apart", [0.0, 1e-6, 1e-3])
def test_a_channel_that_alone_tells_two_parameters_apart_is_not_left_out_whatever_rounding_makes_of_the_rest(
    rng, apart
):
    n = 2000
    channel = np.tile([0, 1], n // 2)
    first = rng.normal(size=n)
    second = np.where(channel == 0, rng.normal(size=n), 0.2 * (1 + apart * rng.normal(size=n)) * first)
    y = 0.01 * rng.normal(size=n) + 0.5 * second + np.where(channel == 1, 0.05 * first, 0.0)
    _, wide = told_by(channel, np.stack([first, second], axis=1), y, ("p0", "p1"))
    assert wide == pytest.approx([0.0176, 0.0040], rel=0.02)


def test_a_parameter_at_its_bound_is_told_by_its_range_and_does_not_widen_the_others(rng):
    model = Model(("linear_drag", "attitude_extra_pole"))
    names = ("attitude_pole_share", "attitude_pole_tau")
    column = rng.normal(size=2000)
    columns = np.stack([column, column + 1e-4 * rng.normal(size=2000)], axis=1)  # told from each other by nothing
    rows = replace(rows_of(rng.normal(size=2000), columns), names=names)
    at_bound = {"attitude_pole_share": 1.0, "attitude_pole_tau": 0.2}
    table = parameter_table(
        SimpleNamespace(model=model, names=names, rows=rows, state=SimpleNamespace(values=at_bound))
    )
    share, tau = table["attitude_pole_share"], table["attitude_pole_tau"]
    assert share["std"] == pytest.approx(3.0 / np.sqrt(12))
    assert share["interval_95"][1] == 1.0
    assert (share.get("at_bound"), tau.get("at_bound")) == (True, None)
    assert tau["std"] < 0.04
    assert tau["scatter"] > 1.0


@pytest.mark.parametrize(
    ("carriers", "bic", "believed"), [(8, -60, True), (4, -60, False), (4, -400, True), (2, -4000, False)]
)
def test_few_responses_are_believed_when_they_agree_and_much_speaks_for_them(carriers, bic, believed):
    parts = np.zeros(40)
    parts[:carriers] = 1.0
    assert plain(parts, bic) is believed
    parts[0] = -1.0
    assert not plain(parts, bic)


def test_what_was_fitted_to_a_residual_goes_along_with_it_by_itself(rng):
    """Of noise alone the best of three directions is taken for an effect as rarely as one that was given beforehand."""
    alarms = {1: 0, 3: 0}
    for _ in range(2000):
        residual, columns = rng.normal(size=40), rng.normal(size=(40, 3))
        for freedom in alarms:
            used = columns[:, :freedom]
            effect = used @ np.linalg.lstsq(used, residual, rcond=None)[0]
            alarms[freedom] += consistency(residual * effect, freedom) < 0.02
    assert alarms[1] < 60
    assert alarms[3] < 60


def test_an_interval_of_the_table_holds_what_channels_disagree_on_and_ends_where_the_range_does(rng):
    names, n = ("attitude_pole_share",), 2000
    channel, column = np.tile([0, 1], n // 2), np.ones((n, 1))
    y = 0.1 * rng.normal(size=n) + np.where(channel == 0, 0.4, -0.4)
    rows = replace(rows_of(y - y.mean(), column, segments=40, channel=channel), names=names)
    state = SimpleNamespace(values={"attitude_pole_share": -1.9})
    model = Model(("linear_drag", "attitude_extra_pole"))
    share = parameter_table(SimpleNamespace(model=model, names=names, rows=rows, state=state))["attitude_pole_share"]
    assert share["std"] > 10 * share["scatter"]
    assert share["interval_95"] == pytest.approx([-2.0, -1.9 + 1.96 * share["std"]])
