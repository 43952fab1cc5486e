"""Models as algebra: sums of terms, equations written out, citations, and simulation from a table."""

import numpy as np
import pytest

from flighttest.errors import InputError, ModelError
from flighttest.physics.catalogue import catalogue
from flighttest.physics.equations import PAPER
from flighttest.physics.model import Model
from flighttest.physics.simulate import simulate


def test_a_term_is_added_and_taken_away():
    term = catalogue()["ground_effect"]
    assert (Model() + term).terms == (Model() + "ground_effect").terms == ("body", "linear_drag", "ground_effect")
    assert (Model() + term - term).terms == Model().terms
    assert (Model() - "linear_drag").terms == ("body",)


def test_what_is_not_there_cannot_be_taken_away():
    with pytest.raises(ModelError, match="no term 'ground_effect'"):
        Model() - "ground_effect"
    with pytest.raises(ModelError, match="did you mean"):
        Model() + "ground_efect"


@pytest.mark.parametrize("term", catalogue().values(), ids=lambda t: t.id)
def test_the_equations_name_every_term_and_every_symbol_with_unit_and_reference(term):
    model = Model(("body", term.id))
    written = model.equations(model.start())
    assert term.equation in str(written)
    assert [s.name for s in written.symbols] == list(model.names)
    assert all(s.unit and s.meaning and s.reference for s in written.symbols)
    assert written.to_frame().loc[term.params[0].name, "term"] == term.id


def test_equations_stand_in_the_order_of_evaluation():
    model = Model(("body", "ground_effect", "quadratic_drag", "throttle_curve"))
    order = [e.term for e in model.equations().equations if e.term != "body"]
    assert order == sorted(order, key=lambda i: list(type(catalogue()[i].port)).index(catalogue()[i].port))


def test_each_work_is_cited_once_and_the_paper_first():
    cited = (Model() + "translational_lift").citations()
    assert cited[0] == PAPER
    assert len(cited) == len(set(cited))
    assert not any(work.startswith("paper") for work in cited)
    assert any("Leishman" in work for work in cited)


def test_a_simulation_from_a_table_is_the_simulation_of_the_model():
    model, t_s = Model(), np.arange(0.0, 1.0, 0.02)
    roll = np.where(t_s > 0.2, 0.2, 0.0)
    found = model.simulate({"t_s": t_s, "roll_ref_rad": roll}, start={"p_z_m": 5.0})
    volts = np.full(t_s.size, model.nominal_voltage_v)
    throttle = model.hover_throttle(model.start(), volts)
    references = {"roll_ref_rad": (t_s, roll), "throttle": (t_s, throttle)}
    expected = simulate(model, model.start(), t_s, {"p_z_m": 5.0}, references, {"voltage_v": (t_s, volts)})
    assert np.array_equal(found.channels["v_y_m_s"], expected["v_y_m_s"])
    assert found.channels["roll_rad"][-1] == pytest.approx(0.2, abs=0.01)
    assert list(model.simulate(found.to_frame().reset_index()[["t_s", "roll_ref_rad"]]).channels["roll_rad"])
    assert {t.name for t in found.plot().data} == set(found.channels)


@pytest.mark.parametrize(
    ("inputs", "values", "start", "said"),
    [
        ({"roll_ref_rad": [0.0, 0.0]}, {}, {}, "no t_s"),
        ({"t_s": [0.0, 0.0]}, {}, {}, "does not increase"),
        ({"t_s": [0.0, 1.0], "throttle": [0.2]}, {}, {}, "throttle has 1 samples, t_s 2"),
        ({"t_s": [0.0, 1.0], "throtle": [0.2, 0.2]}, {}, {}, "no input 'throtle'; did you mean 'throttle'"),
        ({"t_s": [0.0, 1.0], "throttle": [0.2, float("nan")]}, {}, {}, "finite"),
        ({"t_s": [0.0, 1.0], "throttle": ["a", "b"]}, {}, {}, "not made of numbers"),
        ({"t_s": [0.0, 1.0]}, {"k": 1.0}, {}, "no parameter 'k'"),
        ({"t_s": [0.0, 1.0]}, {}, {"height": 1.0}, "no state 'height'"),
    ],
)
def test_inputs_that_cannot_be_used_are_named(inputs, values, start, said):
    with pytest.raises(InputError, match=said):
        Model().simulate(inputs, values, start)
