import casadi as ca
import numpy as np
import pytest

from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from flighttest.physics.simulate import FEW, RungeKuttaStep
from flighttest.physics.vectorised import MappedColumns, Vectorised


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


@pytest.mark.parametrize("n", [1, 5])
def test_few_columns_through_shared_memory_are_what_numpy_gives(n):
    x, u = ca.SX.sym("x", 3), ca.SX.sym("u")
    function = ca.Function("f", [x, u], [ca.vertcat(x[1] * u, ca.sin(x[0]))])
    columns = MappedColumns(function, n)
    rng = np.random.default_rng(4)
    first, second = (rng.normal(size=(3, n)) for _ in range(2))
    kept = columns(first, np.arange(n, dtype=float))
    np.testing.assert_allclose(columns(second, 2.0), Vectorised(function)(second, np.full((1, n), 2.0)), rtol=1e-14)
    np.testing.assert_allclose(kept, Vectorised(function)(first, [np.arange(n)]), rtol=1e-14, err_msg="it is a copy")


def test_a_step_of_few_columns_is_the_step_of_many():
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u")
    step = RungeKuttaStep(ca.Function("rate", [x, u], [ca.vertcat(x[1], -9.0 * ca.sin(x[0]) + u)]))
    rng = np.random.default_rng(5)
    many, dt = rng.normal(size=(2, FEW + 1)), rng.uniform(0.0, 0.05, FEW + 1)
    held = rng.normal(size=(1, FEW + 1))
    after = step(many, held, dt)
    assert not np.allclose(after, many)
    np.testing.assert_allclose(step(many[:, :3], held[:, :3], dt[:3]), after[:, :3], rtol=1e-13)


def test_an_operation_it_does_not_know_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="not known"):
        Vectorised(ca.Function("f", [x], [ca.erf(x)]))
