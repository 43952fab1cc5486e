"""Campaigns shared by the tests of this package."""

import pytest

from flighttest.identify.fit import Fit, fit
from flighttest.segments.model import Segment
from tests.identify.campaign import campaign


@pytest.fixture(scope="session")
def flown() -> list[Segment]:
    """A reduced campaign: two repeats of the thrust cells, two of the tilt cells, two of the yaw cells."""
    return campaign(7, thrust_repeats=2, tilt_repeats=2)


@pytest.fixture(scope="session")
def found(flown: list[Segment]) -> Fit:
    return fit(flown)
