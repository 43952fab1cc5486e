import casadi as ca
import numpy as np
import pytest

from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.physics.vectorised import Vectorised


@pytest.mark.parametrize("term", ["", *sorted(catalogue())])
def test_columns_are_what_casadi_gives_one_by_one(term):
    model = Model().with_terms(term) if term else Model()
    system = model.system
    values = model.start({})
    p = np.array([values[n] for n in system.params]) + 0.01
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    function = ca.Function("rate", [x, u], [system.function(x, u, p)[0]])
    rng = np.random.default_rng(3)
    states = rng.normal(0.0, 0.3, (len(system.states), 7))
    states[list(system.states).index("p_z_m")] = rng.uniform(0.5, 5.0, 7)
    inputs = rng.uniform(0.1, 0.4, (len(system.inputs), 7))
    inputs[list(system.inputs).index("voltage_v")] = rng.uniform(21.0, 25.0, 7)
    found = Vectorised(function)(states, inputs)
    for k in range(7):
        np.testing.assert_allclose(
            found[:, k], np.asarray(function(states[:, k], inputs[:, k])).ravel(), rtol=1e-12, atol=1e-12
        )


def test_an_operation_it_does_not_know_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="not known"):
        Vectorised(ca.Function("f", [x], [ca.erf(x)]))
