"""`status` on recorded sessions of one undamaged vehicle: another day is no change."""

import pytest

from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME, diagnose
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.validity.status import status
from flighttest.validity.model import ValidityVerdict


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "vehicle", "tested"),
    [
        ("controller_data", "E8", ["thrust", "motors"]),
        ("motor_data", "E9", ["drag", "throttle_offset", "thrust", "motors"]),
    ],
)
def test_an_undamaged_vehicle_is_current_on_another_day(shared_data, tmp_path, log, vehicle, tested):
    """The later session's throttle offset of 0.11 +- 0.05 was called new; 2.3 % of thrust was 4.1 standard errors. The offset that the
    first session of E9 shows, 0.105 +- 0.018, is in the later one, too (p 0.54)."""
    folder = shared_data / "propeller_damage" / log / "normal_flight"
    own, later = ([folder / f"{vehicle}_log0{k}" for k in which] for which in ((3, 4), (0, 1, 2)))
    diagnose(open_recordings(own), output=tmp_path)
    found = status(open_recordings(later), None, tmp_path / MODEL_NAME, tmp_path).value
    assert found.verdict is ValidityVerdict.CURRENT
    assert [t.subset for t in found.tests] == tested
    assert not any("came" in sentence for sentence in found.cannot_tell)
