"""The wind of real flights, distinguished from an attitude offset by what it does to the drag."""

from dataclasses import replace

import pytest

from flighttest.diagnose import diagnose
from flighttest.diagnose.free_flight.equation_search import find_terms
from flighttest.identify.free_flight import stretches
from flighttest.identify.free_flight.winds import BESIDE_WIND, WIND_TERM, FlightWind, WindVerdict, in_still_air, winds
from flighttest.physics.catalogue import catalogue
from flighttest.pipeline.identification.fitting import base_model
from flighttest.pipeline.recordings.sources import Reading, open_recordings
from flighttest.segments import cut

FAN_M_S = 4.2  # of the flights `35wind`, from the north


def read(shared_data, repository, *flights):
    """Segments of some flights, and a model of their vehicle."""
    paths = [shared_data / "wind_tunnel" / f"custom_figure8_{flight}.csv.gz" for flight in flights]
    recordings = open_recordings(paths, Reading(repository / "examples" / "columns" / "neural_fly.yaml"))
    return tuple(s for r in recordings for s in cut(r)), base_model(recordings, None)


def diagnosed(shared_data, repository, *flights, **options):
    return diagnose(*read(shared_data, repository, *flights), **options)


@pytest.mark.slow
def test_a_wind_is_named_where_the_fan_blew_and_its_interval_holds_that_of_the_fan(shared_data, repository):
    found = diagnosed(shared_data, repository, "NF-T_35wind", only=(WIND_TERM, *BESIDE_WIND, "translational_lift"))
    assert "steady_wind" in found.accepted
    (wind,) = found.winds
    assert wind["w_north"] == pytest.approx(-4.2, abs=2.0 * wind["w_north_std"])
    assert wind["w_north_std"] < 2.0
    (row,) = [f.parameters[f"w_north@{wind['flight']}"] for f in found.findings if f.term == "steady_wind"]
    half = wind["factor_95"] * wind["w_north_std"]  # what the table of winds prints is the interval of the finding
    assert row["interval_95"] == pytest.approx([wind["w_north"] - half, wind["w_north"] + half])


@pytest.mark.slow
@pytest.mark.parametrize("flight", ["L1_70wind", "NF-C_70wind", "NF-T_70wind"])
def test_no_offset_that_vehicles_do_not_have_makes_a_wind_stronger(shared_data, repository, flight):
    """At one heading an offset of 5 to 9 degrees beside drag that goes with thrust had 10.1 to 11.2 m/s for the fans' 8.5."""
    segments, model = read(shared_data, repository, flight)
    (wind,) = winds(segments, model).flights
    assert abs(wind.north + 8.5) < 1.5
    assert abs(wind.north + 8.5) < wind.factor_95 * wind.north_std


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flight", "m_u", "m_w"),
    [("NF-T_nowind", 1.2, 0.0), ("L1_70wind", 2.0, 2.7)],
)
def test_moments_of_the_air_are_named_where_the_motors_trim_them(shared_data, repository, flight, m_u, m_w):
    """The motor commands, which no model here reads, make up for a moment by forward speed that is the same in wind and without, and for
    one by climb in wind alone (tests/proof/test_public_list.py): the derivatives are like that, too."""
    rivals = ("reference_shaping", "attitude_extra_pole", "roll_pitch_coupling")
    found = diagnosed(shared_data, repository, flight, only=("airflow_moment", WIND_TERM, *BESIDE_WIND, *rivals))
    assert "airflow_moment" in found.accepted
    (moment,) = [f.parameters for f in found.findings if f.term == "airflow_moment"]
    assert found.values["m_u"] == pytest.approx(m_u, abs=1.0)
    assert moment["m_u"]["interval_95"][0] > 0.5
    assert found.values["m_w"] == pytest.approx(m_w, abs=1.0)
    pitch = found.heldout["pitch"]["all"]
    assert pitch["rmse_after"] < pitch["rmse_before"]


@pytest.mark.slow
def test_moments_that_go_with_the_thrust_are_no_shaping_of_references(shared_data, repository):
    """In a wind of 4.2 m/s moments without the thrust left 86 nats to a shaping that no autopilot of these flights has."""
    segments, model = read(shared_data, repository, "L1_35wind", "NF-C_35wind", "NF-T_35wind")
    runs = dict.fromkeys(s.run for s in segments)
    known = [FlightWind(run, -FAN_M_S, 0.0, 0.0, 0.0, 0.0, WindVerdict.WIND, 2.0) for run in runs]
    found = find_terms(
        stretches(in_still_air(segments, known), "roll_pitch"), model, tuple(catalogue().values()), part="roll_pitch"
    )
    assert "airflow_moment" in found.named
    assert "reference_shaping" not in found.named


@pytest.mark.slow
@pytest.mark.parametrize(
    "flights", [("L1_nowind", "NF-C_nowind"), ("L1_nowind", "NF-C_nowind", "NF-T_nowind")], ids=len
)
def test_still_air_is_not_called_wind(shared_data, repository, flights):
    """Three flights together were "steady wind", beside a table in which none of them had one; two had one of 16 +- 10 m/s along an axis
    with a drag of 0.008 +- 0.008 1/s."""
    segments, model = read(shared_data, repository, *flights)
    tilts = tuple(catalogue()[t] for t in (WIND_TERM, *BESIDE_WIND))
    found = find_terms(stretches(segments), replace(model, attitude_loops=False), tilts)
    assert "steady_wind" in found.offered
    assert "steady_wind" not in found.named
    assert not found.winds
