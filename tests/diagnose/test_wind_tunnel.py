"""The wind of real flights, distinguished from an attitude offset by what it does to the drag."""

import pytest

from flighttest.diagnose.free_flight.assembly import diagnose_free_flight
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.segments import cut


def diagnosed(shared_data, repository, *flights):
    paths = [shared_data / "wind_tunnel" / f"custom_figure8_{flight}.csv.gz" for flight in flights]
    recordings = open_recordings(paths, Reading(repository / "examples" / "columns" / "neural_fly.yaml"))
    return diagnose_free_flight([s for r in recordings for s in cut(r)], base_model(recordings, None))


def test_a_wind_is_named_where_the_fan_blew_and_its_interval_holds_that_of_the_fan(shared_data, repository):
    found = diagnosed(shared_data, repository, "NF-T_35wind")
    assert "steady_wind" in found.accepted
    (wind,) = found.winds
    assert wind["w_north"] == pytest.approx(-4.2, abs=2.0 * wind["w_north_std"])
    assert wind["w_north_std"] < 2.0


@pytest.mark.parametrize("flights", [("NF-C_nowind",), ("L1_nowind", "NF-C_nowind", "NF-T_nowind")])
def test_still_air_is_not_called_wind(shared_data, repository, flights):
    """Three flights together were "steady wind", beside a table in which none of them had one."""
    found = diagnosed(shared_data, repository, *flights)
    assert "steady_wind" not in found.accepted
    assert not found.winds
