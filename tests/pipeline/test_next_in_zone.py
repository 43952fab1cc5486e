"""A proposed flight that the vehicle's zone has no space for is marked so; what is known of the zone decides, not the usual one."""

import re
from dataclasses import dataclass, field, replace

import pytest
import yaml

from flighttest.documents import write_text
from flighttest.physics.model import Model
from flighttest.pipeline.diagnosis.next_flight import flyable_in, held_against_zone
from flighttest.pipeline.planning.checking import predictor_for
from flighttest.plan import compile_plan
from flighttest.recording import Provenance, Recording
from flighttest.report.render.plain import plain
from flighttest.report.sections.diagnosis import diagnosis_sections
from flighttest.script.load import parse_script
from flighttest.script.shipped import resolve
from flighttest.vehicle.model import DEFAULT_VEHICLE, Zone

SMALL = replace(DEFAULT_VEHICLE, name="small", zone=Zone(0.0, (-3.0, 3.0), (-3.0, 3.0), (1.0, 6.0), 1.0))


@dataclass(frozen=True)
class Proposal:
    """The parts of a diagnosis that are about the next flight."""

    next_script: dict
    next_reason: dict = field(default_factory=lambda: {"maneuver": "two_heights"})
    model: Model = field(default_factory=Model)
    values: dict = field(default_factory=dict)


@pytest.fixture(scope="module")
def proposal():
    script = yaml.safe_load(resolve("two_heights").read_text())
    return Proposal(script | {"name": "next", "doc": "two_heights, to see", "repeat": {"each": 1}})


def recorded(vehicle):
    return [Recording("r", {}, (), Provenance("", "table", vehicle=vehicle))]


@pytest.mark.parametrize("declared", [True, False])
def test_a_proposal_that_does_not_fit_says_so(proposal, declared):
    """By the vehicle file, or by the run that was flown with one."""
    found = held_against_zone(proposal, recorded({} if declared else plain(SMALL)), SMALL if declared else None)
    assert found.next_reason["fits_zone"] is False
    assert "steps do not fit the zone of small" in found.next_reason["zone"]
    assert "above the ceiling" in found.next_reason["zone"]
    assert found.next_script["doc"].startswith("two_heights, to see; ")
    assert "do not fit the zone of small" in found.next_script["doc"]
    data = {"next_flight": "next.yaml", "next_reason": found.next_reason}
    shown = [s for s in diagnosis_sections(data, "") if s.id == "next"]
    assert found.next_reason["zone"] in str(shown)


def test_a_proposal_that_fits_stays_as_it_is(proposal):
    found = held_against_zone(proposal, recorded(plain(SMALL)), DEFAULT_VEHICLE)
    assert found.next_reason["fits_zone"] is True
    assert found.next_script == proposal.next_script
    nameless = held_against_zone(proposal, recorded(plain(replace(DEFAULT_VEHICLE, name=""))), None)
    assert nameless.next_reason["zone"].endswith("steps fit the vehicle's zone.")


@pytest.mark.parametrize("kept", [{}, {"name": "old"}, {"name": "old", "zone": {"x_m": 3}}])
def test_where_no_zone_is_known_nothing_is_said(proposal, kept):
    assert held_against_zone(proposal, recorded(kept), None) is proposal


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_heights", "speed_dash"])
def test_a_maneuver_is_made_smaller_until_every_step_fits(name):
    vehicle = replace(DEFAULT_VEHICLE, zone=Zone(0.0, (-5.0, 5.0), (-5.0, 5.0), (1.0, 6.0), 1.0))
    script = yaml.safe_load(resolve(name).read_text()) | {"repeat": {"each": 1}}
    made, size = flyable_in([], vehicle)(script, Model(), {})
    assert 0.0 < size < 1.0
    prior = predictor_for(None, vehicle)
    assert not compile_plan(parse_script(write_text(made)), vehicle, prior).refusals
    assert compile_plan(parse_script(write_text(script)), vehicle, prior).refusals, "as it is it does not fit"


@pytest.mark.slow
def test_where_nothing_fits_the_smallest_zone_that_would_do_is_said(proposal):
    tiny = replace(DEFAULT_VEHICLE, name="tiny", zone=Zone(0.0, (-1.2, 1.2), (-1.2, 1.2), (0.5, 3.0), 1.0))
    assert flyable_in([], tiny)(proposal.next_script, Model(), {}) is None
    found = held_against_zone(proposal, [], tiny)
    words = found.next_reason["zone"]
    assert "m would do." in words
    numbers = [float(w) for w in re.findall(r"-?\d+\.?\d*", words.partition("A zone of")[2])]
    zone = Zone(0.0, tuple(numbers[0:2]), tuple(numbers[2:4]), tuple(numbers[4:6]), 1.0)
    script = parse_script(write_text(proposal.next_script))
    assert not compile_plan(script, replace(tiny, zone=zone), predictor_for(None, tiny)).refusals
