"""Against a flight the model describes exactly the full model wins, and each simplification loses where it must."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import FitError
from flighttest.identify.models.model_file import ModelFile, from_fit
from flighttest.identify.validation.ablations import GROUPS, Variation, voltage_for
from flighttest.identify.validation.validate import HORIZONS_S, joined_windows, validate
from flighttest.physics.simulate import simulate
from flighttest.segments.model import Segment
from tests.identify.campaign import TRUTH


@pytest.fixture(scope="module")
def flight(found):
    """24 s of weaving free flight in three windows, from Table 2's vehicle, a little noise."""
    rng = np.random.default_rng(11)
    t = np.arange(0.0, 24.0, 0.02)
    edges = np.arange(-1.0, 24.0, 0.1)
    roll, pitch = 0.45 * np.sin(1.9 * edges), 0.4 * np.sin(1.3 * edges + 1)
    hover = 9.81 / (TRUTH["K"] * (24.3 / 22.2) ** TRUTH["alpha"])
    u = {
        "roll_ref_rad": (edges, roll), "pitch_ref_rad": (edges, pitch), "yaw_rate_ref_rad_s": (edges, np.sin(0.9 * edges)),
        "throttle": (edges, hover / np.cos(roll) / np.cos(pitch) * (1 + 0.08 * np.sin(2.2 * edges))),
    }  # fmt: skip
    values = found.model.start({n: TRUTH[n] for n in TRUTH})
    made = simulate(found.model, values, t, {"p_z_m": 6.0}, u, {"voltage_v": (t, np.full(t.size, 24.3))})
    y = {
        c: v + 1e-3 * rng.standard_normal(v.shape)
        for c, v in made.items()
        if c in {c for g in GROUPS.values() for c in g}
    }
    y |= {c: made[c] for c in ("q_rad_s", "f_z_m_s2")} | {"voltage_v": np.full(t.size, 24.3)}
    cuts = [slice(0, 400), slice(400, 800), slice(800, t.size)]
    return [
        Segment(f"free {k}", "f", "free", {}, k, t[c][0], t[c], {n: v[c] for n, v in y.items()}, u)
        for k, c in enumerate(cuts)
    ]


@pytest.fixture(scope="module")
def table(found, flight):
    return validate(from_fit(found), flight, previous=from_fit(found))


@pytest.mark.slow
def test_the_full_model_beats_each_simplification(table):
    for variation in (Variation.LINEARISED, Variation.NO_DRAG, Variation.NO_BATTERY, Variation.HOLD):
        for horizon in (0.5, 1.5, 3.0):
            assert table.rmse(Variation.FULL, "position", horizon) < 0.7 * table.rmse(variation, "position", horizon), (
                variation
            )
    assert table.rmse(Variation.FULL, "roll", 0.5) < 0.2 * table.rmse(Variation.ONLY_DELAY, "roll", 0.5)
    assert table.rmse(Variation.FULL, "yaw rate", 0.5) < 0.3 * table.rmse(Variation.ONLY_DELAY, "yaw rate", 0.5)


def test_only_the_attitude_suffers_from_only_delay_and_only_the_rest_from_no_drag(table):
    full = table.rmse(Variation.FULL, "roll", 1.0)
    assert table.rmse(Variation.NO_DRAG, "roll", 1.0) == pytest.approx(full)
    assert table.rmse(Variation.LINEARISED, "roll", 1.0) == pytest.approx(full, rel=1e-6)
    assert table.rmse(Variation.PREVIOUS, "position", 3.0) == pytest.approx(table.rmse(Variation.FULL, "position", 3.0))


def test_errors_grow_with_the_horizon_and_are_small(table):
    position = [table.rmse(Variation.FULL, "position", h) for h in HORIZONS_S]
    assert position[-1] < 0.25
    assert position[0] < 0.02


def test_few_starts_are_called_few(table, found, flight):
    """24 s of flight hold eight stretches of 3 s; 4 s hold one, however many starts overlap in it."""
    whole = {(e.group, e.horizon_s): e for e in table.errors if e.variation is Variation.FULL}
    assert whole["position", 3.0].stretches in (7, 8)
    assert whole["position", 3.0].few == ""
    assert "only" not in table.sentences[0]
    short = flight[0]
    cut = slice(0, 200)
    short = replace(short, t_s=short.t_s[cut], y={n: v[cut] for n, v in short.y.items()})
    seen = validate(from_fit(found), [short])
    brief = {(e.group, e.horizon_s): e for e in seen.errors if e.variation is Variation.FULL}
    late = brief["position", 3.0]
    assert late.stretches == 1 < late.count < 8
    assert f"from {late.count} starts only, in 1 separate stretch of flight" in seen.sentences[0]
    assert brief["position", 0.1].few == ""


def test_windows_of_one_flight_are_joined(flight):
    joined = joined_windows(list(reversed(flight)))
    assert len(joined) == 1
    assert joined[0].t_s.size == 1200
    assert np.all(np.diff(joined[0].t_s) > 0)


def test_figure_5_shows_every_variation_over_one_and_a_half_seconds(table):
    figure = table.figure
    assert figure.t_s[-1] == pytest.approx(1.5, abs=0.03)
    assert set(figure.simulated) == set(Variation)
    for channels in figure.simulated.values():
        assert channels["p_x_m"].shape == figure.t_s.shape == figure.measured["p_x_m"].shape


def test_a_flight_without_throttle_cannot_be_validated(found, flight):
    bare = [Segment(s.name, s.run, s.kind, s.cell, s.repeat, s.t_step_s, s.t_s, s.y, {}) for s in flight]
    with pytest.raises(FitError, match="throttle"):
        validate(from_fit(found), bare)


@pytest.mark.slow
def test_residuals_on_the_flight_are_tested_for_the_commands(table, found, flight):
    windows = [s for f in flight for s in pieces(f, 4)]
    right = {t.channel: t for t in validate(from_fit(found), windows).residuals}
    assert not right["v_x_m_s"].follows
    wrong = from_fit(found)
    slow = ModelFile(**{**vars(wrong), "values": {**wrong.values, "omega_phi": 12.0}})
    tested = {t.channel: t for t in validate(slow, windows).residuals}
    assert tested["roll_rad"].follows
    assert "follows the roll command" in tested["roll_rad"].sentence


def pieces(segment, count):
    n = segment.t_s.size // count
    cuts = [slice(k * n, (k + 1) * n) for k in range(count)]
    return [replace(segment, t_s=segment.t_s[c], y={n: v[c] for n, v in segment.y.items()}) for c in cuts]


def test_a_flight_without_voltage_is_flown_at_the_models_own(found, flight):
    stored = from_fit(found)
    deaf = [replace(s, y={n: v for n, v in s.y.items() if n != "voltage_v"}) for s in flight]
    low, high = stored.valid["voltage_v"]
    seen = voltage_for(stored, deaf[0]).y["voltage_v"]
    assert seen == pytest.approx(0.5 * (low + high))
    assert voltage_for(stored, flight[0]) is flight[0]


@pytest.mark.slow
def test_a_model_of_flights_without_voltage_takes_none(found, flight):
    stored = from_fit(found)
    parameters = {**stored.parameters, "alpha": replace(stored.parameters["alpha"], source="assumed", std=None)}
    blind = replace(stored, parameters=parameters, valid={})
    assert voltage_for(blind, flight[0]).y["voltage_v"] == pytest.approx(stored.model.nominal_voltage_v)
    assert validate(blind, flight).rmse(Variation.NO_BATTERY, "velocity", 1.0) is None


def test_errors_are_reported_at_the_horizons_asked_for(found, flight):
    table = validate(from_fit(found), flight[:1], horizons_s=(0.01, 0.04, 0.2))
    velocity = {e.horizon_s: e for e in table.errors if e.variation is Variation.FULL and e.group == "velocity"}
    assert list(velocity) == [0.04, 0.2]  # the samples lie 20 ms apart
    assert 0.0 < velocity[0.2].mean <= velocity[0.2].rmse
