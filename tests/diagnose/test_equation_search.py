"""Which terms a search of free flight estimates, and which leave."""

from dataclasses import replace

import pytest

from flighttest.diagnose.free_flight import equation_search
from flighttest.diagnose.free_flight.equation_screen import screen
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.identify.free_flight import stretches
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model
from tests.identify.test_free_flight import flight


def test_a_term_that_a_later_one_drives_to_its_bound_leaves_and_takes_that_one_with_it():
    """A throttle offset of 0.26, which is not looked for. Beside a limit that was not there the curvature, 1.38 by itself, went to 1.5."""
    flown = [
        replace(s, u={**s.u, "throttle": (s.u["throttle"][0], s.u["throttle"][1] + 0.26)})
        for s in stretches(flight(60, 11, gust=0.1, climb=1.0))
    ]
    found = find_terms(
        flown, Model(attitude_loops=False), [catalogue()[n] for n in ("throttle_curve", "motor_saturation")]
    )
    assert not found.named
    assert "curvature is at its bound" in found.refused["throttle_curve"][1]
    assert found.left == ["throttle_curve", "motor_saturation"]


@pytest.mark.parametrize(("share", "named"), [(1.0, ["quadratic_drag"]), (0.01, [])])
def test_a_term_of_the_translation_is_estimated_for_its_likelihood_alone(monkeypatch, share, named):
    """In 75 s an accelerometer 0.05 m off the centre had p 0.0008 in the score test, where 0.0004 is asked, and 294 nats."""

    def of_few_blocks(*args):
        return tuple(replace(s, p_value=0.5, nats=share * s.nats) for s in screen(*args))

    monkeypatch.setattr(equation_search, "screen", of_few_blocks)
    flown = stretches(flight(60.0, 24, gust=0.1, climb=1.0, run="fast", quadratic=(0.2, 0.2, 0.2)))
    assert list(find_terms(flown, Model(attitude_loops=False), [catalogue()["quadratic_drag"]]).named) == named
