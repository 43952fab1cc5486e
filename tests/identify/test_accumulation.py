"""Estimates as responses are added: on linear responses one Gauss-Newton step is the estimate itself."""

import numpy as np
import pytest

from flighttest.identify.validation.accumulation import accumulations, steps


def test_of_linear_responses_the_steps_are_the_least_squares_of_the_first_ones():
    rng = np.random.default_rng(1)
    truth = np.array([3.0, -40.0])
    designs = rng.standard_normal((6, 4, 2)) * [1.0, 0.02]
    designs[0, :, 1] = 0.0  # the first response determines the first parameter alone
    measured = designs @ truth + 0.1 * rng.standard_normal((6, 4))
    final = np.linalg.lstsq(designs.reshape(-1, 2), measured.ravel())[0]
    hessian = np.einsum("nki,nkj->nij", designs, designs)
    score = np.einsum("nki,nk->ni", designs, measured - designs @ final)
    shift, std = steps(hessian, score)
    assert np.isnan(shift[0, 1])
    alone = float(designs[0, :, 0] @ measured[0] / (designs[0, :, 0] @ designs[0, :, 0]))
    assert shift[0, 0] + final[0] == pytest.approx(alone)
    for k in range(1, 6):
        a, b = designs[: k + 1].reshape(-1, 2), measured[: k + 1].ravel()
        assert shift[k] + final == pytest.approx(np.linalg.lstsq(a, b)[0])
        assert std[k] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(a.T @ a))))


def test_directions_that_no_response_shows_are_no_estimate():
    pair = np.array([[1.0, 2.0]])
    shift, std = steps((pair.T @ pair)[None], np.ones((1, 2)))
    assert np.isnan(shift).all()
    assert np.isnan(std).all()


def test_the_last_point_is_the_fits_own(found):
    kept = accumulations(found)
    assert {"K", "sigma_t", "omega_phi"} <= {a.name for a in kept}
    for a in kept:
        e = found.estimates[a.name]
        assert a.value[-1] == pytest.approx(e.value)
        assert 2.0 * a.half_width[-1] == pytest.approx(e.interval_95[1] - e.interval_95[0])
        assert np.all(np.diff(a.half_width) < 1e-9 * a.half_width[0]), "more responses never hold less information"
        assert np.all(np.diff(a.count) > 0)
