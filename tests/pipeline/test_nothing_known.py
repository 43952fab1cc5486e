"""A fit that determines nothing gives the reasons in ten lines."""

from flighttest.pipeline.identification.fitting import fit


def test_a_fit_that_determines_nothing_gives_the_reasons(shared_data):
    result = fit([shared_data / "arducopter_logs" / "copter_3.2_2014.BIN"])
    first = result.document.sections[0]
    assert first.title == "Why nothing is known"
    (bullets,) = first.blocks
    assert 3 <= len(bullets.items) <= 10
    assert "flighttest run roll_pitch" in " ".join(bullets.items)


def test_a_fit_that_determines_something_gives_no_such_list(flight_csv):
    assert all(s.id != "why" for s in fit([flight_csv]).document.sections)
