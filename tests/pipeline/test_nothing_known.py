"""A fit that knows nothing says why in ten lines."""

from flighttest.pipeline.identification.fitting import fit


def test_a_fit_that_knows_nothing_says_why(shared_data):
    result = fit([shared_data / "arducopter_logs" / "copter_3.2_2014.BIN"])
    first = result.document.sections[0]
    assert first.title == "Why nothing is known"
    (bullets,) = first.blocks
    assert 3 <= len(bullets.items) <= 10
    assert "flighttest run roll_pitch" in " ".join(bullets.items)


def test_a_fit_that_knows_something_says_nothing_of_it(flight_csv):
    assert all(s.id != "why" for s in fit([flight_csv]).document.sections)
