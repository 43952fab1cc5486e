"""A fit that determines nothing gives the reasons in ten lines."""

import numpy as np
import pandas as pd
import pytest

from flighttest.pipeline.identification.fitting import fit


def hover(folder, seconds=3.5):
    """Nothing is asked for and nothing moves but the noise of the instruments, which drowns what the throttle does."""
    rng, t = np.random.default_rng(3), np.arange(0.0, seconds, 0.02)
    noise = {
        "roll_rad": 0.02,
        "pitch_rad": 0.02,
        "yaw_rad": 0.02,
        "v_x_m_s": 0.3,
        "v_y_m_s": 0.3,
        "v_z_m_s": 0.3,
        "f_z_m_s2": 2.0,
    }
    table = {"t_s": t} | {name: rng.normal(9.81 * (name == "f_z_m_s2"), std, t.size) for name, std in noise.items()}
    wanted = {"roll_ref_rad": 0.0, "pitch_ref_rad": 0.0, "throttle": 0.2 + 0.001 * np.sin(t)}
    pd.DataFrame(table | wanted).to_csv(folder / "hover.csv", index=False)
    return folder / "hover.csv"


def test_a_fit_that_determines_nothing_gives_the_reasons(tmp_path):
    result = fit([hover(tmp_path)])
    first = result.document.sections[0]
    assert first.title == "Why nothing is known"
    (bullets,) = first.blocks
    assert 3 <= len(bullets.items) <= 10
    assert "flighttest run roll_pitch" in " ".join(bullets.items)


@pytest.mark.slow
def test_a_hover_shows_the_gain_that_carries_the_vehicle_and_nothing_else(tmp_path):
    """It was not identifiable by output error, beside a constant force that nothing measures."""
    fitted = fit([hover(tmp_path, 20.0)]).value
    known = {n: e for n, e in fitted.estimates.items() if e.identifiable}
    assert list(known) == ["K"]
    low, high = known["K"].interval_95
    assert low < 9.80665 / 0.2 < high


@pytest.mark.slow
def test_a_fit_that_determines_something_gives_no_such_list(flight_csv):
    assert all(s.id != "why" for s in fit([flight_csv]).document.sections)
