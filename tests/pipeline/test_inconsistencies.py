"""What is said of recordings before anything is computed of them."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import FitError
from flighttest.pipeline.diagnosis import diagnose as diagnosis
from flighttest.pipeline.identification import fitting as analysis
from flighttest.pipeline.recordings.consistency import (
    conflicts,
    deduplicate,
    inconsistencies,
    not_carried,
    repeated,
    unfiltered,
)
from flighttest.pipeline.recordings.fingerprints import differences
from flighttest.recording import Provenance, Recording, Series


def test_recordings_of_two_vehicles_are_called_so():
    def recorded(name, part):
        return Recording(name, {}, (), Provenance("", "table", components={"propellers": {"id": part}}))

    a, b = recorded("a", "P1"), recorded("b", "P2")
    assert "a and b are not of one vehicle: propellers P1, here P2" in conflicts([a, recorded("c", "P1"), b])
    assert conflicts([a, recorded("c", "P1")]) == ""
    heron, stork = (
        replace(a, name=n, provenance=replace(a.provenance, vehicle={"name": n})) for n in ("heron", "stork")
    )
    assert "heron and stork are not of one vehicle: heron and stork;" in conflicts([heron, stork])
    assert conflicts([heron, a]) == "", "a name that is not stated is none of another vehicle"
    assert conflicts([a, Recording("table", {}, (), Provenance("", "table"))]) == "", "not declared is not changed"
    assert differences({"components": {"propellers": {"id": "P1"}}}, [b]) == "propellers P1, here P2"


def test_a_recording_that_is_given_twice_is_reported():
    a, b = (Recording(name, {}, (), Provenance("", "table", sha256=sha)) for name, sha in (("a", "1"), ("b", "2")))
    again = Recording("a-2", {}, (), a.provenance)
    assert "a and a-2 are one recording" in repeated([a, b, again])
    assert repeated([a, b]) == ""


@pytest.mark.slow
def test_fit_and_diagnosis_count_a_recording_once(monkeypatch, flight_csv):
    given = []

    def search(segments, *_args, **_more):
        given.append(len(segments))
        raise FitError("enough", "")

    monkeypatch.setattr(diagnosis, "search", search)
    monkeypatch.setattr(analysis, "fit_segments", search)
    for work in (diagnosis.diagnose, analysis.fit):
        for runs in ([flight_csv], [flight_csv, flight_csv]):
            with pytest.raises(FitError):
                work(runs)
    assert given[0] > 0
    assert len(set(given)) == 1
    assert [r.name for r in deduplicate([Recording(n, {}, (), Provenance("", "table", sha256=n)) for n in "aba"])] == [
        "a",
        "b",
    ]


def test_a_filter_that_was_not_declared_is_a_doubt():
    t = np.arange(5.0)
    series = {"specific_force": Series(t, {f"f_{a}_m_s2": t for a in "xyz"})}
    bare = Recording("bare", series, (), Provenance("", "table"))
    stated = Recording("stated", series, (), Provenance("", "table", filters={"specific_force": 20.0}))
    assert "not stated for bare:" in unfiltered([stated, bare, Recording("still", {}, (), Provenance("", "table"))])
    assert unfiltered([stated]) == ""


@pytest.mark.parametrize(
    ("reads", "gains", "said"),
    [
        (4.2, 0.0, "reads 4.2 m/s^2 up in the mean of the flight, and by the velocity 9.8"),
        (6.9, 0.0, "reads 6.9"),
        (8.2, 0.0, ""),  # an old one's error
        (9.81, 0.0, ""),
        (19.6, 9.8, ""),  # thrown upwards: the velocity shows it
    ],
)
def test_an_accelerometer_that_does_not_carry_the_vehicle_is_a_doubt(reads, gains, said):
    """Of a hover in a hardware-in-the-loop simulation whose accelerometer read half of g, K was known as 9.1 m/s^2, with which nothing
    flies, nothing was missing, and no word was said of it."""
    t = np.arange(0.0, 20.0, 0.05)
    series = {
        "specific_force": Series(t, {"f_x_m_s2": 0 * t, "f_y_m_s2": 0 * t, "f_z_m_s2": np.full(t.size, reads)}),
        "velocity": Series(t, {"v_x_m_s": 0 * t, "v_y_m_s": 0 * t, "v_z_m_s": gains * t}),
        "attitude": Series(t, {"roll_rad": 0 * t, "pitch_rad": 0 * t, "yaw_rad": 0 * t}),
        "reference": Series(t, {"throttle": np.full(t.size, 0.5)}),
    }
    doubt = not_carried([Recording("hover", series, (), Provenance("", "table"))])
    assert said in doubt if said else doubt == ""
    short = {group: Series(t[:60], {n: v[:60] for n, v in one.columns.items()}) for group, one in series.items()}
    assert not_carried([Recording("hop", short, (), Provenance("", "table"))]) == ""  # of 3 s a mean says little


def test_every_doubt_is_reported_and_the_gravest_first():
    a, b = (Recording(n, {}, (), Provenance("", "table", sha256=n, components={"battery": {"id": n}})) for n in "ab")
    said = inconsistencies([a, b, a.__class__("a-2", {}, (), a.provenance)])
    assert ["not of one vehicle" in said[0], "are one recording" in said[1], len(said)] == [True, True, 2]
    assert inconsistencies([a]) == ()
