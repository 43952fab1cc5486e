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
    (row,) = [f.parameters[f"w_north@{wind['flight']}"] for f in found.findings if f.term == "steady_wind"]
    half = wind["factor_95"] * wind["w_north_std"]  # what the table of winds prints is the interval of the finding
    assert row["interval_95"] == pytest.approx([wind["w_north"] - half, wind["w_north"] + half])


@pytest.mark.parametrize("flight", ["L1_35wind", "NF-C_70wind"])
def test_moments_of_the_air_are_named_where_the_motors_trim_one(shared_data, repository, flight):
    """Half to two thirds of the pitch error of each flight in wind had no name. The motor commands, which no model here reads, show the
    moment: front and rear differ by 90 to 100 us in wind and by 20 without. The pitch error falls to a third where it was not used, and
    the derivatives are the same at 4.2 and at 8.5 m/s."""
    found = diagnosed(shared_data, repository, flight)
    assert "airflow_moment" in found.accepted
    pitch = found.heldout["pitch"]["all"]
    assert pitch["rmse_after"] < 0.4 * pitch["rmse_before"]
    assert found.values["m_u"] == pytest.approx(1.4, abs=0.4)
    assert found.values["m_w"] == pytest.approx(1.6, abs=0.4)


@pytest.mark.parametrize(
    "flights", [("NF-C_nowind",), ("L1_nowind", "NF-C_nowind"), ("L1_nowind", "NF-C_nowind", "NF-T_nowind")]
)
def test_still_air_is_not_called_wind(shared_data, repository, flights):
    """Three flights together were "steady wind", beside a table in which none of them had one; two had one of 16 +- 10 m/s along an axis
    with a drag of 0.008 +- 0.008 1/s."""
    found = diagnosed(shared_data, repository, *flights)
    assert not {"steady_wind", "airflow_moment"} & set(found.accepted)
    assert not found.winds
