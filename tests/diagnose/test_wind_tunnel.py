"""The wind of real flights, distinguished from an attitude offset by what it does to the drag."""

import pytest

from flighttest.diagnose import diagnose
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.segments import cut


def diagnosed(shared_data, repository, *flights):
    paths = [shared_data / "wind_tunnel" / f"custom_figure8_{flight}.csv.gz" for flight in flights]
    recordings = open_recordings(paths, Reading(repository / "examples" / "columns" / "neural_fly.yaml"))
    return diagnose([s for r in recordings for s in cut(r)], base_model(recordings, None))


def test_a_wind_is_named_where_the_fan_blew_and_its_interval_holds_that_of_the_fan(shared_data, repository):
    found = diagnosed(shared_data, repository, "NF-T_35wind")
    assert "steady_wind" in found.accepted
    (wind,) = found.winds
    assert wind["w_north"] == pytest.approx(-4.2, abs=2.0 * wind["w_north_std"])
    assert wind["w_north_std"] < 2.0
    (row,) = [f.parameters[f"w_north@{wind['flight']}"] for f in found.findings if f.term == "steady_wind"]
    half = wind["factor_95"] * wind["w_north_std"]  # what the table of winds prints is the interval of the finding
    assert row["interval_95"] == pytest.approx([wind["w_north"] - half, wind["w_north"] + half])


@pytest.mark.parametrize(
    ("flight", "m_u", "m_w"),
    [("NF-T_nowind", 1.2, 0.0), ("L1_35wind", 2.0, 2.7), ("L1_70wind", 2.0, 2.7)],
)
def test_moments_of_the_air_are_named_where_the_motors_trim_them(shared_data, repository, flight, m_u, m_w):
    """The motor commands, which no model here reads, make up for a moment by forward speed that is the same in wind and without, and for
    one by climb in wind alone (tests/proof/test_public_list.py): the derivatives are like that, too."""
    found = diagnosed(shared_data, repository, flight)
    assert "airflow_moment" in found.accepted
    (moment,) = [f.parameters for f in found.findings if f.term == "airflow_moment"]
    assert found.values["m_u"] == pytest.approx(m_u, abs=1.0)
    assert moment["m_u"]["interval_95"][0] > 0.5
    assert found.values["m_w"] == pytest.approx(m_w, abs=1.0)
    pitch = found.heldout["pitch"]["all"]
    assert pitch["rmse_after"] < pitch["rmse_before"]


def test_moments_that_go_with_the_thrust_are_no_shaping_of_references(shared_data, repository):
    """In a wind of 4.2 m/s moments without the thrust left 86 nats to a shaping that no autopilot of these flights has."""
    found = diagnosed(shared_data, repository, "L1_35wind", "NF-C_35wind", "NF-T_35wind")
    assert "airflow_moment" in found.accepted
    assert "reference_shaping" not in found.accepted


@pytest.mark.parametrize(
    "flights", [("NF-C_nowind",), ("L1_nowind", "NF-C_nowind"), ("L1_nowind", "NF-C_nowind", "NF-T_nowind")]
)
def test_still_air_is_not_called_wind(shared_data, repository, flights):
    """Three flights together were "steady wind", beside a table in which none of them had one; two had one of 16 +- 10 m/s along an axis
    with a drag of 0.008 +- 0.008 1/s."""
    found = diagnosed(shared_data, repository, *flights)
    assert "steady_wind" not in found.accepted
    assert not found.winds
