"""The sections and figures of a diagnosis."""

import pytest

from flighttest.report.document import Bullets, Document, Figure, Panel, Trace
from flighttest.report.render import figures, html
from flighttest.report.sections.diagnosis import diagnosis_sections, missing_sections, verdict_tone
from flighttest.report.sections.diagnosis_figures import before_after


def test_an_interrupted_diagnosis_is_no_good_news():
    data = {"verdict": "NOTHING_MISSING", "sentence": "Interrupted.", "located": [], "findings": []}
    assert verdict_tone(data) == "good"
    assert verdict_tone({**data, "complete": False}) == "warn"
    shown = Document("diagnosis", "Interrupted.", "warn", diagnosis_sections({**data, "complete": False}))
    assert "of what was searched before the interruption" in html.page_of(shown)


@pytest.mark.parametrize(
    ("verdict", "said"),
    [("UNKNOWN_PHYSICS", "explains this mismatch"), ("NOTHING_MISSING", "is needed to explain these recordings")],
)
def test_where_something_without_a_name_is_missing_no_page_says_that_nothing_is_needed(verdict, said):
    data = {"verdict": verdict, "sentence": "Something.", "located": [], "findings": []}
    shown = html.page_of(Document("diagnosis", "Something.", "warn", diagnosis_sections(data)))
    assert f"No physics of the catalogue {said}." in shown


def test_a_drop_is_printed_no_finer_than_the_errors_beside_it():
    """Beside 0.0272 and 0.0272 stood "-0.0000014 to 0.0000318", and beside 0.0495 one of 2e-7 in green."""
    held = {
        "f_x": {"rmse_before": 0.0272, "rmse_after": 0.0272, "floor": 0.0269, "gain_95": [-1.4e-6, 3.18e-5]},
        "f_y": {"rmse_before": 0.0495, "rmse_after": 0.0495, "floor": 0.0458, "gain_95": [1e-9, 2.1e-7]},
        "f_z": {"rmse_before": 0.326, "rmse_after": 0.192, "floor": 0.179, "gain_95": [0.033, 0.226]},
    }
    (section,) = missing_sections({"findings": [{"term": "throttle_curve"}], "heldout": held})
    table = section.blocks[-1]
    assert [row[-1] for row in table.rows] == ["0.0000 to 0.0000", "0.0000 to 0.0000", "0.033 to 0.226"]
    assert [row[2].tone for row in table.rows] == ["plain", "plain", "good"]


def test_the_responses_shown_are_those_that_missed_by_most_noise_floors():
    def flown(channel, error):
        return {"channel": channel, "segment": f"{channel} {error}", "t_s": [0.0, 1.0], "before": [0.0, 0.0],
                "after": [error, error], "measured": [error, error]}  # fmt: skip

    data = {
        "overlays": [flown("roll", e) for e in (3e-3, 2e-3, 1e-3)] + [flown("v_z", e) for e in (0.4, 0.3, 0.1, 0.01)],
        "noise_floor": {"roll": {"value": 1e-3}, "v_z": {"value": 0.02}},
        "findings": [{"term": "ground_effect"}],
    }
    shown = before_after(data)
    assert [p.title for p in shown.panels] == [
        "v_z 0.4",
        "v_z 0.3",
        "v_z 0.1",
        "roll 0.003",
        "roll 0.002",
        "roll 0.001",
    ]
    assert [t.name for t in shown.panels[0].traces] == ["before", "after", "measured"]
    clean = before_after({**data, "findings": []})
    assert [t.name for t in clean.panels[0].traces] == ["simulated", "measured"], (
        "nothing was left out: one line, not two"
    )


def test_noise_alone_is_pale_in_a_map_of_errors():
    def top(largest):
        heat = Trace(["steady"], ["roll"], "noise floors", "other", "heat", z=[[largest]])
        return figures.specification(Figure("f", (Panel("map", "", "", (heat,)),), "c"))["panels"][0]["data"][0]["zmax"]

    assert top(1.8) == 4.0
    assert top(9.0) == 9.0


def test_a_picture_comes_before_any_list():
    """Two sentences and the picture are what a reader sees first; lists and tables follow it."""
    cells = [
        {
            "channel": c,
            "maneuver": "m",
            "kind": "roll_step",
            "phase": "steady",
            "before_floors": 3.0,
            "after_floors": 1.0,
        }
        for c in ("v_x", "r")
    ]
    data = {
        "located": [
            {"channel": "v_x", "sentence": "velocity north in roll steps: 1 m/s^2 where repeats differ by 0.1"}
        ],
        "residual_map": cells,
    }
    blocks = diagnosis_sections(data)[0].blocks
    assert [type(b) for b in blocks[:2]] == [Figure, Bullets]
    assert blocks[1].items == ("Velocity north in roll steps: 1 m/s² where repeats differ by 0.1.",)
    assert list(blocks[0].panels[0].traces[0].y) == ["velocity north", "yaw rate"]
