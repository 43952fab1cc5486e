"""Frequency responses and correlations of residuals, on responses whose answer is known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.identify.response_analysis.comparison import fitted_responses
from flighttest.identify.response_analysis.frequency_response import frequency_responses, residual_correlations

LAG_S = 0.15
T = np.arange(-0.5, 3.0, 0.01)


def made(amplitudes, noise=0.0, model_lag_s=LAG_S, seed=0):
    """A fit of first-order steps: what `response_analysis` reads of one, nothing else."""
    rng = np.random.default_rng(seed)
    segments, responses, measured, residual = [], [], [], []
    for i, a in enumerate(amplitudes):

        def answer(lag, a=a):
            return a * np.where(T > 0.0, 1.0 - np.exp(-np.maximum(T, 0.0) / lag), 0.0)

        y = answer(LAG_S) + noise * rng.standard_normal(T.size)
        u = {"roll_ref_rad": (np.array([-5.0, 0.0]), np.array([0.0, a]))}
        segments.append(SimpleNamespace(name=f"s{i}", run="r", kind="roll_step", u=u, t_s=T, t_step_s=0.0))
        responses.append(SimpleNamespace(index=i, t_s=T))
        measured.append(y[:, None])
        residual.append((y - answer(model_lag_s))[:, None])
    part = SimpleNamespace(
        outputs=("roll_rad",), responses=responses, y=np.array(measured), mask=np.ones((len(segments), T.size, 1), bool)
    )
    problem = SimpleNamespace(parts=[part], segments=segments)
    solution = SimpleNamespace(evaluations=[SimpleNamespace(residual=np.array(residual))])
    return SimpleNamespace(problem=problem, solution=solution, quality={"roll_rad": SimpleNamespace(floor=0.01)})


def test_a_first_order_loop_has_its_frequency_response():
    (loop,) = frequency_responses(made((0.1, -0.2, 0.3, -0.3), noise=1e-4))
    f = loop.frequency_hz < 4.0
    truth = 1.0 / (1.0 + 2j * np.pi * loop.frequency_hz[f] * LAG_S)
    assert np.abs(loop.measured[f] - truth).max() < 0.03
    assert np.abs(loop.model[f] - truth).max() < 0.03
    assert loop.coherence[f].min() > 0.99
    assert frequency_responses(made((0.1, -0.2))) == (), "two steps have no coherence"


def test_a_model_that_is_too_slow_shows_in_its_curve_and_in_the_correlation():
    found = made((0.1, -0.2, 0.3, -0.3), noise=1e-4, model_lag_s=0.3)
    (loop,) = frequency_responses(found)
    at = int(np.argmin(np.abs(loop.frequency_hz - 1.0)))
    assert abs(loop.measured[at]) > 1.3 * abs(loop.model[at])
    (wrong,) = residual_correlations(found)
    (right,) = residual_correlations(made((0.1, -0.2, 0.3, -0.3), noise=1e-2))
    assert wrong.auto[5] > 0.5
    assert np.mean(np.abs(right.auto[1:]) < right.band) > 0.9, "white noise stays in its band"
    assert right.auto[0] == pytest.approx(1.0)
    assert np.abs(wrong.cross).max() > 5.0 * np.abs(right.cross).max()


def test_a_response_is_shown_with_its_command_and_what_is_left():
    (first, *rest) = fitted_responses(made((0.1, -0.2), noise=1e-3))
    assert [r.name for r in (first, *rest)] == ["r: s0", "r: s1"]
    (channel,) = first.channels
    assert channel.floor == 0.01
    assert np.std(channel.measured - channel.simulated) == pytest.approx(1e-3, rel=0.2)
    assert set(first.commands) == {"roll_ref_rad"}
    assert first.commands["roll_ref_rad"][-1] == 0.1
