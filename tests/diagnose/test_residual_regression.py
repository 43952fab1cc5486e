"""What stays without a name is described only where the description holds for data it has not seen."""

import numpy as np

from flighttest.diagnose.output_error.residual_regression import candidate_functions, sparse_choice


def _table(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    w = rng.uniform(-3.0, 3.0, n)
    return {"w": w, "w^2": w**2, "|w| w": np.abs(w) * w}


def test_a_law_is_found_and_says_what_it_leaves():
    rng = np.random.default_rng(1)
    table = _table(rng, 600)
    chosen, left = sparse_choice(0.4 * table["w^2"] + 0.1 * rng.standard_normal(600), table, np.arange(600) % 4)
    assert chosen == ["w^2"]
    assert 0.0 < left < 0.05


def test_what_is_no_better_than_nothing_is_no_description():
    """Every group has its own mean: what holds for the others makes each of them worse, whatever else is learnt."""
    rng = np.random.default_rng(2)
    fold = np.arange(600) % 4
    table = _table(rng, 600)
    sign = np.array([1.0, -1.0, 1.0, -1.0])[fold]
    r = 3.0 * sign + table["w"] + 0.1 * rng.standard_normal(600)
    assert sparse_choice(r, table, fold) == ([], 1.0)


def test_sparse_regression_keeps_the_one_function_that_is_there():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(600, 6))
    r = 2.0 * x[:, 3] ** 2 + rng.normal(0, 0.3, 600)
    table = {f"x{k}": x[:, k] for k in range(6)} | {f"x{k}^2": x[:, k] ** 2 for k in range(6)}
    chosen, left = sparse_choice(r, table, np.arange(600) % 5)
    assert chosen == ["x3^2"]
    assert left < 0.1
    assert sparse_choice(rng.normal(size=600), table, np.arange(600) % 5)[0] == []


def test_a_formula_names_the_variables_in_it_and_its_knots_with_their_sign():
    found = candidate_functions({"speed_up_m_s": np.linspace(-3.0, 0.0, 11), "tilt_rad": np.linspace(0.0, 0.5, 11)})
    values, uses = found["max(w + 1.8, 0)"]
    assert values[-1] == 1.8
    assert uses == ("speed_up_m_s",)
    assert found["tilt^2"][1] == ("tilt_rad",)
    assert found["w tilt"][1] == ("speed_up_m_s", "tilt_rad")
