"""Tails and quantiles against scipy.stats."""

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from flighttest.estimation.uncertainty import distributions


@pytest.mark.parametrize("dof", [1.0, 2.5, 17.3, 1e4])
@pytest.mark.parametrize("p", [1e-9, 0.025, 0.6, 0.975])
def test_quantiles_and_tails_are_those_of_scipy_stats(dof, p):
    z = stats.t.ppf(p, dof)
    assert distributions.quantile(p, dof) == pytest.approx(z, rel=1e-12)
    assert distributions.beyond(z, dof) == pytest.approx(2.0 * stats.t.sf(abs(z), dof), rel=1e-12)
    assert distributions.normal_quantile(p) == pytest.approx(stats.norm.ppf(p), rel=1e-12)
    assert distributions.normal_beyond(z) == pytest.approx(2.0 * stats.norm.sf(abs(z)), rel=1e-12)
    assert distributions.chi2_beyond(abs(z), dof) == pytest.approx(stats.chi2.sf(abs(z), dof), rel=1e-9)
    assert distributions.fisher_quantile(p, 3, dof) == pytest.approx(stats.f.ppf(p, 3, dof), rel=1e-9)
    assert distributions.fisher_beyond(abs(z), 3, dof) == pytest.approx(stats.f.sf(abs(z), 3, dof), rel=1e-12)


@pytest.mark.parametrize(("ratio", "above", "below"), [(0.3, 20, 50), (1.0, 96, 480), (1.3, 40, 7), (8.0, 5, 300)])
def test_the_mean_excess_of_a_variance_ratio_is_that_of_its_distribution(ratio, above, below):
    """v is distributed as ratio over F: quantiles of v from those of 1 / F."""
    p = (np.arange(200_000) + 0.5) / 200_000
    excess = np.maximum(ratio * stats.f.ppf(p, below, above) - 1.0, 0.0).mean()
    assert distributions.expected_excess(ratio, above, below) == pytest.approx(excess, rel=2e-3, abs=1e-6)


def test_a_variance_ratio_of_two_degrees_of_freedom_has_no_mean():
    assert distributions.expected_excess(1.0, 2.0, 50.0) == math.inf
    assert distributions.expected_excess(0.0, 9.0, 50.0) == 0.0


@pytest.mark.slow
def test_fitting_loads_no_statistics_package():
    code = "import flighttest.cli.main, flighttest.pipeline.identification.fitting, sys; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "False"
