"""Terms that a search of free flight has named, and that later ones drive out of what their name means."""

from dataclasses import replace

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
