"""Orthonormal columns of many matrices, against Householder's."""

import numpy as np
import pytest

from flighttest.estimation.linearisation import orthonormal_each


@pytest.mark.parametrize("spread", [1.0, 1e-6, 1e-12])
def test_columns_of_any_size_become_orthonormal_and_span_what_they_did(spread):
    rng = np.random.default_rng(1)
    made = rng.normal(size=(7, 60, 5)) * spread ** np.linspace(0, 1, 5)
    found = orthonormal_each(made)
    assert np.allclose(found.swapaxes(1, 2) @ found, np.eye(5), atol=1e-14)
    for k in range(1, 6):
        left = made[..., k - 1] - np.einsum("mnl,mkl,mk->mn", found[..., :k], found[..., :k], made[..., k - 1])
        assert np.linalg.norm(left) < 1e-13 * np.linalg.norm(made[..., k - 1])


def test_columns_that_are_nearly_one_are_distinguished():
    rng = np.random.default_rng(1)
    made = rng.normal(size=(3, 60, 4))
    made[..., 3] = made[..., 0] + 1e-9 * rng.normal(size=(3, 60))
    found = orthonormal_each(made)
    assert np.allclose(found.swapaxes(1, 2) @ found, np.eye(4), atol=1e-12)
    assert np.allclose(np.abs(found), np.abs(np.linalg.qr(made)[0]), atol=1e-6)


def test_no_column_is_no_column():
    assert orthonormal_each(np.zeros((4, 9, 0))).shape == (4, 9, 0)
