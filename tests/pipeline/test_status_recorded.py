"""`status` on recorded sessions of one undamaged vehicle: another day is no change."""

import pytest

from flighttest.pipeline.diagnosis.diagnose import MODEL_NAME, diagnose
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.validity.status import status
from flighttest.validity.model import ValidityVerdict


@pytest.mark.parametrize(("log", "vehicle"), [("controller_data", "E8"), ("motor_data", "E9")])
def test_an_undamaged_vehicle_is_current_on_another_day(shared_data, tmp_path, log, vehicle):
    """The later session's throttle offset of 0.11 +- 0.05 was called new; 2.3 % of thrust was 4.1 standard errors."""
    folder = shared_data / "propeller_damage" / log / "normal_flight"
    own, later = ([folder / f"{vehicle}_log0{k}" for k in which] for which in ((3, 4), (0, 1, 2)))
    diagnose(open_recordings(own), output=tmp_path)
    found = status(open_recordings(later), None, tmp_path / MODEL_NAME, tmp_path).value
    assert found.verdict is ValidityVerdict.CURRENT
    assert [t.subset for t in found.tests] == ["thrust", "motors"]
    assert not any("came" in sentence for sentence in found.cannot_tell)
