"""Tails and quantiles against scipy.stats."""

import subprocess
import sys

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


def test_fitting_loads_no_statistics_package():
    code = "import flighttest.cli.main, flighttest.pipeline.identification.fitting, sys; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "False"
