"""A wind is a name for several flights only where one of them has one."""

import pytest

from flighttest.diagnose.free_flight.equation_search import seen_somewhere
from flighttest.identify.winds import FlightWind, WindVerdict


@pytest.mark.parametrize(
    ("verdicts", "seen"), [(("none seen",), True), (("none seen", "none seen"), False), (("none seen", "wind"), True)]
)
def test_over_several_flights_one_of_them_must_have_a_wind(verdicts, seen):
    """Three flights in still air were "steady wind" beside a table that saw none in any of them."""
    winds = [FlightWind(f"f{k}", 0.7, 0.1, 1.0, 0.5, 0.5, WindVerdict(v)) for k, v in enumerate(verdicts)]
    assert seen_somewhere(winds) is seen
