"""An operator sees in one screen what changed, why it matters, what to fly and how long it takes."""

import io

import numpy as np
import pytest
from rich.console import Console

from flighttest.report.render.terminal import render
from flighttest.report.sections.validity import Reflight, status_document
from flighttest.validity.assess import RecordingEvidence, assess
from flighttest.validity.compare import Estimates, MatchedPairs

NAMES = ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r", "sigma_t", "K", "d_x", "d_y", "d_z")
VALUES = np.array([25.4, 23.4, 0.44, 0.39, 21.5, 20.4, 54.5, 0.39, 0.39, 0.51])
FLIGHTS = (
    Reflight("at least", ("thrust",), 10.0, "flighttest run thrust"),
    Reflight("all (the rule)", ("roll_pitch", "yaw_rate", "thrust"), 16.9, "flighttest run roll_pitch yaw_rate thrust"),
)


def found(resistance=(0.02, 0.0004), **factors):
    exact = Estimates("model", NAMES, VALUES, np.zeros((10, 10)))
    moved = VALUES * [factors.get(n, 1.0) for n in NAMES]
    after = Estimates("new", NAMES, moved, np.diag((0.003 * VALUES) ** 2))
    return assess(
        model_fingerprint={}, vehicle_fingerprint=None, stored=exact,
        new=RecordingEvidence(runs=[after], matched=MatchedPairs(exact, after, 12), battery=resistance, battery_reference=resistance),
    )  # fmt: skip


def screen(validity, width=80):
    out = io.StringIO()
    facts = {"model": "model.yaml", "new flight": "runs/2026-11-21T11-12-05-spot_check"}
    Console(file=out, width=width).print(render(status_document(validity, facts, FLIGHTS, brief=True)))
    return out.getvalue()


def test_all_of_it_is_on_one_small_screen():
    text = screen(found(K=0.95))
    assert len(text.rstrip().splitlines()) <= 24, text
    said = " ".join(text.replace("│", " ").split())
    for words in ("thrust per throttle fell 5.0 %", "Why it matters: at the throttle that held height it now sinks with 0.5 m/s²",
                  "10 min 00 s flighttest run thrust", "16 min 54 s flighttest run roll_pitch yaw_rate thrust",
                  "another mass"):  # fmt: skip
        assert words in said, words


def test_a_battery_without_resistance_is_shown_as_such():
    assert "internal resistance" in screen(found(resistance=(0.0, 0.001)))


def test_nothing_to_fly_where_nothing_changed():
    text = screen(found())
    assert "Current: the new recording agrees" in text
    assert "what to fly" not in text


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({"omega_phi": 0.8, "omega_theta": 0.8}, "a tilt takes 25 % longer to arrive"),
        ({"sigma_r": 0.7}, "a turn takes 43 % longer to arrive"),
        ({"K": 1.06}, "it now climbs with 0.6 m/s²"),
        ({"sigma_t": 0.6}, "thrust takes 67 % longer to come"),
    ],
)
def test_why_it_matters_is_said_in_numbers(factors, words):
    assert any(words in sentence for sentence in found(**factors).impact), found(**factors).impact


def test_a_long_list_of_parameters_stays_short():
    model = {
        "shaping_parameters": {f"ATC_RAT_RLL_{i}": 1.0 for i in range(40)},
        "components": {"battery": {"id": "B1"}},
    }
    today = {
        "shaping_parameters": {f"ATC_RAT_RLL_{i}": 2.0 for i in range(40)},
        "components": {"battery": {"id": "B2"}},
    }
    exact = Estimates("model", NAMES, VALUES, np.zeros((10, 10)))
    text = screen(assess(model_fingerprint=model, vehicle_fingerprint=today, stored=exact))
    assert len(text.splitlines()) < 40
    assert "and 35 more" in text
    assert text.index("B2") < text.index("ATC_RAT_RLL_0"), "what a person changed comes first"
