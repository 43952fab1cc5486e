"""What is reported of a fitted model and of a named term."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.diagnose.answer import TOGETHER, PartAnswer, error_left
from flighttest.diagnose.conclusion import predicted_worse, sentence_of, verdict_of
from flighttest.diagnose.findings import parameter_table, share_gained, with_owner
from flighttest.diagnose.model import EXPLAINED_SHARE, Verdict
from flighttest.diagnose.output_error.reported import undetermined_sizes
from flighttest.diagnose.records import ABOVE_FLOOR, WITH_GUSTS, HeldOutRow
from flighttest.identify.fit import Estimate
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

SHARE, TAU = "attitude_pole_share", "attitude_pole_tau"


def fit_of(at_bound=(), **estimates):
    model = Model(("linear_drag", "attitude_extra_pole"))
    table = {
        n: Estimate(n, n, "1", value, std, interval, "fit", True, scatter=std)
        for n, (value, std, interval) in estimates.items()
    }
    values = {n: e.value for n, e in table.items()}
    return SimpleNamespace(model=model, estimates=table, solution=SimpleNamespace(at_bound=at_bound, values=values))


def test_the_table_holds_what_the_fit_holds():
    table = parameter_table(fit_of(**{SHARE: (0.9, 0.2, (0.4, 1.0)), TAU: (0.05, 0.01, (0.03, 0.07))}))
    assert table[TAU] == {"value": 0.05, "std": 0.01, "unit": "1", "interval_95": [0.03, 0.07], "scatter": 0.01}
    assert table[SHARE]["interval_95"] == [0.4, 1.0]


def test_a_parameter_at_its_bound_is_reported_by_its_range():
    table = parameter_table(fit_of((SHARE,), **{SHARE: (1.0, None, None), TAU: (0.05, 0.01, (0.03, 0.07))}))
    assert table[SHARE]["std"] == pytest.approx(1.1 / np.sqrt(12))
    assert table[SHARE]["interval_95"] == [-0.1, 1.0]
    assert (table[SHARE].get("at_bound"), table[TAU].get("at_bound")) == (True, None)


def test_a_parameter_at_its_bound_with_an_interval_has_that_of_the_model():
    """A lag at its bound was 0.012 to 0.2 s in the report and 0.012 to 0.025 s in model.yaml."""
    row = parameter_table(fit_of((SHARE,), **{SHARE: (1.0, 0.1, (0.8, 1.0))}))[SHARE]
    assert (row["std"], row["interval_95"], row["at_bound"]) == (0.1, [0.8, 1.0], True)


def test_what_was_not_estimated_is_not_in_the_table():
    assert set(parameter_table(fit_of(**{SHARE: (0.9, None, None), TAU: (0.05, 0.01, (0.03, 0.07))}))) == {TAU}


@pytest.mark.parametrize(
    ("intervals", "said"),
    [
        (
            {"m_u": (-0.6, 3.6), "l_v": (-7.0, 2.4), "m_w": (-0.1, 3.0), "l_w": (-0.2, 0.1)},
            "each coefficient contains it",
        ),
        ({"m_u": (0.8, 1.9), "l_v": (-7.0, 2.4), "m_w": (-0.1, 3.0), "l_w": (-0.2, 0.1)}, ""),
        ({"m_u": (-0.6, 3.6)}, "its coefficient contains it"),
        ({"moment_trim_1_s": (0.5, 1.5)}, ""),
    ],
)
def test_a_name_beside_intervals_that_contain_its_absence_says_so(intervals, said):
    rows = {n: {"value": 0.5 * sum(i), "interval_95": list(i)} for n, i in intervals.items()}
    found = undetermined_sizes(catalogue()["airflow_moment"], rows)
    assert said in found
    assert bool(found) is bool(said)


@pytest.mark.parametrize(
    ("before", "after", "gain"), [(2.0, 1.0, 1.0), (2.0, 2.0, 0.0), (2.0, 3.0, -5 / 3), (0.9, 0.5, 0.0)]
)
def test_the_gain_is_the_share_of_what_lies_above_the_floor(before, after, gain):
    held = {"f_z": {"rmse_before": before, "rmse_after": after, "floor": 1.0}}
    assert share_gained(held["f_z"]) == pytest.approx(gain)


@pytest.mark.parametrize(
    ("after", "high", "said"),
    [
        (0.66, -0.28, "acceleration west (3.3 times the error)"),
        (0.226, -0.01, "acceleration west (13 % more error)"),
        (0.66, 0.02, "acceleration west (3.3 times the error, which may be chance)"),
        (0.25, 0.02, "acceleration west (25 % more error, which may be chance)"),
        (0.23, 0.02, ""),
        (0.2002, -1e-4, "acceleration west (0.1 % more error)"),
        (0.20005, -1e-5, ""),
        (0.03, -0.01, ""),
        (0.1, 0.15, ""),
    ],
)
def test_what_is_predicted_worse_with_what_is_named_is_said_in_the_headline(after, high, said):
    """What is surely worse, or by more than a fifth, and above the noise floor. Seven flights, of which two had 14 and 60 % more error in
    roll, had an interval that contained zero, and 25 % more error was not said."""
    row = HeldOutRow(rmse_before=0.2, rmse_after=after, floor=0.04, gain_95=[-0.6, high])
    other = HeldOutRow(rmse_before=0.2, rmse_after=0.22, floor=0.04, gain_95=[-0.2, 0.1])
    sentence = predicted_worse({"a_y": {"all": row}, "v_z": {"all": other}})
    assert (said in sentence) if said else sentence == ""
    assert "velocity" not in sentence


@pytest.mark.parametrize(
    ("errors", "said"),
    [((ABOVE_FLOOR, ABOVE_FLOOR), ABOVE_FLOOR), ((WITH_GUSTS,), WITH_GUSTS), ((ABOVE_FLOOR, WITH_GUSTS), "error")],
)
def test_shares_of_errors_of_several_kinds_are_called_shares_of_the_error(errors, said):
    nothing = PartAnswer(error="of a part without a share")
    assert error_left([nothing, *(PartAnswer(shares={"v_z": 0.1}, error=one) for one in errors)]) == (
        pytest.approx(0.1),
        said,
    )


@pytest.mark.parametrize(
    ("stays", "together", "left"), [(0.25, False, 0.25), (0.15, False, 0.025), (0.25, True, 0.25), (0.15, True, 0.03)]
)
def test_what_is_explained_in_one_channel_makes_up_for_nothing_in_another(stays, together, left):
    """Beside a firmware's reference shaping, an updraft that left 1.1 m/s of vertical velocity over a floor of 0.04 was EXPLAINED, and a
    thrust that rings, which left 0.35 m/s^2 over a floor of 0.09, since angle boost explains the velocity."""
    loops = PartAnswer(shares=dict.fromkeys(("roll", "pitch", "r", "f_x"), 0.0), staying={"roll"})
    force = PartAnswer(shares={"f_z": stays, "v_z": 0.0}, staying={"f_z", "v_z"})
    steered = PartAnswer(shares={TOGETHER: stays}, staying={"f_z"})
    answers = [loops, steered if together else force]
    share, error = error_left(answers)
    assert share == pytest.approx(left)
    assert error.removeprefix(ABOVE_FLOOR) == ("" if stays <= EXPLAINED_SHARE else " in specific force up")
    unexplained = any(a.unexplained for a in answers)
    assert unexplained is (stays > EXPLAINED_SHARE)
    verdict = verdict_of(named=True, located=True, unexplained=unexplained)
    assert verdict is (Verdict.PARTLY if unexplained else Verdict.EXPLAINED)


@pytest.mark.parametrize(
    ("term", "begins"),
    [
        ("attitude_extra_pole", "This is your autopilot (a third pole in the attitude loop): it lags"),
        ("imu_lever_arm", "This is your sensor (IMU away from the centre of mass): it lags"),
        ("quadratic_drag", "it lags"),
    ],
)
def test_a_sentence_begins_with_whose_the_term_is_where_it_is_no_physics(term, begins):
    assert with_owner(catalogue()[term], "it lags") == begins


@pytest.mark.parametrize(("left", "removed"), [(0.9995, "less than 1 %"), (0.51, "49 %")])
def test_what_is_named_never_removes_nothing(left, removed):
    """Of a pilot's flight: "The base model lacks: turning moves roll and pitch. Adding it removes 0 % of the error"."""
    named = SimpleNamespace(title="Turning moves roll and pitch", rivals=(), term="turn_axes")
    assert f"Adding it removes {removed} of the {WITH_GUSTS}." in sentence_of(
        Verdict.EXPLAINED, [named], (left, WITH_GUSTS), [], True
    )
