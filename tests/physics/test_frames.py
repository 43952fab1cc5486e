"""Frames: one vector is converted as a stack of them is, and components as the vector."""

import numpy as np
import pytest

from flighttest import frames
from flighttest.vehicle.model import Zone

VECTORS = np.random.default_rng(0).normal(size=(20, 3))


@pytest.mark.parametrize("convert", [frames.quaternion_from_euler, frames.rotation_from_euler])
def test_one_vector_is_converted_as_a_stack_is(convert):
    for one, expected in zip(VECTORS, convert(VECTORS), strict=True):
        assert convert(one).shape == expected.shape
        assert convert(list(one)) == pytest.approx(expected, rel=1e-15, abs=1e-15)


def test_components_are_flipped_as_the_vector_is():
    flipped = frames.flip_vector(VECTORS)
    assert np.array_equal(np.stack(frames.flip_components(*VECTORS.T), axis=-1), flipped)
    assert frames.flip_components(1.0, 2.0, -3.0) == tuple(frames.flip_vector([1.0, 2.0, -3.0]))


def test_a_place_over_ground_is_that_of_the_zones_frame():
    zone = Zone(heading_rad=0.7)
    for place in VECTORS:
        assert zone.over_ground(place[0], place[1]) == tuple(zone.from_world(place)[:2])
        assert zone.to_world(zone.from_world(place)) == pytest.approx(place)
