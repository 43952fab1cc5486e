"""A proposed flight that the vehicle's zone has no room for says so; what is known of the zone decides, not the usual one."""

from dataclasses import dataclass, field, replace

import pytest
import yaml

from flighttest.physics.model import Model
from flighttest.pipeline.next_in_zone import held_against_zone
from flighttest.recording import Provenance, Recording
from flighttest.report.diagnosis_sections import diagnosis_sections
from flighttest.report.plain import plain
from flighttest.script.shipped import resolve
from flighttest.vehicle.default import DEFAULT_VEHICLE
from flighttest.vehicle.model import Zone

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


@pytest.mark.parametrize("kept", [{}, {"name": "old"}, {"name": "old", "zone": {"x_m": 3}}])
def test_where_no_zone_is_known_nothing_is_said(proposal, kept):
    assert held_against_zone(proposal, recorded(kept), None) is proposal
