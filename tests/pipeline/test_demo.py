"""`flighttest demo`: what is concealed reaches the simulator and the end of the page; the picture and the commands are right."""

import shlex
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from flighttest.cli.main import call, cli
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.model import Model
from flighttest.pipeline import demo as demos
from flighttest.pipeline.identification.fitting import cut_all
from flighttest.pipeline.recordings.sources import open_recordings
from flighttest.pipeline.results import Result, Status
from flighttest.report.document import Document, Figure, Panel, Trace
from flighttest.report.render.svg import as_svg
from flighttest.report.sections.demo import demo_document

HIDE = ("slung_payload:payload_ratio=0.137,cable_m=1.0",)
FINDING = {
    "term": "slung_payload",
    "title": "Slung payload",
    "verdict": "SUPPORTED",
    "parameters": {"payload_ratio": {"value": 0.131, "std": 0.004, "unit": "1", "interval_95": [0.123, 0.139]}},
    "evidence": {"probability": 0.9999},
}
DATA = {
    "hidden": {"slung_payload": {"payload_ratio": 0.137}},
    "findings": [FINDING],
    "as_hidden": True,
    "prediction": {"v_x_m_s": {"before": 0.05, "after": 0.01, "floor": 0.009}},
    "shown": None,
    "twin": {"verdict": "NOTHING_MISSING", "channels": {}, "near_floor": 1.2},
    "twin_report": "twin/report.html",
    "unused": "spot_check",
}


def stored(**changed):
    model = Model()
    values = {**model.start(), "omega_phi": 25.43, "zeta_phi": 0.44, "K": 54.55, "alpha": 1.71, **changed}
    parameters = {n: StoredParameter(values[n], model.param[n].unit, 0.01) for n in model.names}
    return ModelFile(model, parameters, values, (), np.zeros((0, 0)), {}, path="model.yaml")


def texts(document):
    return [f"{s.title} {s.lead} {s.blocks}" for s in document.sections]


def test_what_was_hidden_is_shown_in_the_last_section_before_the_commands():
    document = demo_document(DATA, [("Make it the model:", "flighttest accept run")], "report.html")
    assert [s.id for s in document.sections] == ["prediction", "twin", "truth", "next"]
    reported = ["0.137" in text for text in [document.verdict, *texts(document)]]
    assert reported == [False, False, False, True, False]
    assert "payload_ratio 0.1310" in document.verdict
    assert "predicts the velocity north to 0.010 m/s (RMS), the base model to 0.050 m/s" in document.verdict
    assert (
        "hidden: slung_payload payload_ratio 0.137; found: slung payload (payload_ratio 0.1310)." in texts(document)[2]
    )


@pytest.mark.parametrize(
    ("hidden", "findings", "said"),
    [
        ({"ground_effect": {"R2_m2": 0.01}}, [], "not found"),
        ({"ground_effect": {"R2_m2": 0.01}}, [FINDING], "nothing"),
        ({"slung_payload": {}}, [FINDING], "its default"),
    ],
)
def test_what_was_not_found_or_was_not_hidden_is_said(hidden, findings, said):
    data = DATA | {"hidden": hidden, "findings": findings, "as_hidden": False}
    document = demo_document(data, [], "report.html")
    assert said in texts(document)[2]
    assert ("found nothing missing" in document.verdict) == (not findings)


def test_the_simulator_alone_is_reported_and_the_printed_commands_exist(tmp_path, monkeypatch):
    asked = []

    def run(request, _progress):
        asked.append(request)
        (request.out / request.scripts[-1]).mkdir()
        data = {
            "runs": [str(request.out / request.scripts[-1])],
            "diagnosis": {"findings": [FINDING], "noise_floor": {}},
        }
        return Result(Document("", ""), data, Status.DONE)

    verified = Result(Document("", ""), DATA["twin"], value=SimpleNamespace(fit=SimpleNamespace(noise=None)))
    monkeypatch.setattr(demos, "run", run)
    monkeypatch.setattr(demos.model_file, "read", lambda *_args, **_more: stored())
    monkeypatch.setattr(demos.twins, "verify", lambda *_args, **_more: verified)
    monkeypatch.setattr(demos, "open_recordings", lambda *_args, **_more: ())
    monkeypatch.setattr(demos, "prediction_quality", lambda *_: {})
    monkeypatch.setattr(demos, "predicted_stretch", lambda *_: None)
    out = tmp_path / "a demo"
    out.mkdir()
    (out / "kept").touch()  # an accepted model there would be the base of the diagnosis
    found = demos.demo(demos.DemoRequest(out, seed=5, hide=HIDE))
    assert [(r.scripts, r.hide, r.fly_only, r.model) for r in asked] == [
        (demos.CAMPAIGN, HIDE, False, None),
        ((demos.UNUSED,), HIDE, True, None),
    ]
    assert len({r.seed + i for r in asked for i in range(len(r.scripts))}) == 4, "no flight is flown twice"
    assert Path(found.data["report"]) == tmp_path / "a demo-2" / "report.html"
    assert Path(found.data["report"]).is_file()
    for block in found.document.sections[-1].blocks:
        program, name, *words = shlex.split(block.text.replace("\\\n", ""))  # as a shell joins lines
        assert program == "flighttest"
        assert cli.commands[name].make_context(name, words, parent=cli.make_context("flighttest", ["doctor"]))


def test_the_stretch_shown_is_where_the_improved_model_is_better(flight_csv):
    usable = [s for s in cut_all(open_recordings([flight_csv])) if s.usable]
    segments = [s for kind in ("roll_step", "throttle_step") for s in [s for s in usable if s.kind == kind][:2]]
    base, improved = stored(K=51.0), stored()
    shown = demos.predicted_stretch(segments, base, improved, {"v_z_m_s": 0.02, "roll_rad": 0.002})
    assert shown["channel"] == "v_z_m_s"
    errors = [np.sqrt(np.mean((shown[k] - shown["measured"]) ** 2)) for k in ("before", "after")]
    assert errors[1] < 0.5 * errors[0]
    assert demos.predicted_stretch(segments, improved, improved, {"v_z_m_s": 0.02}) is None


def test_an_effect_that_the_vehicle_does_not_have_is_refused_before_anything_is_written(tmp_path, capsys):
    assert call(["demo", "--hide", "slung_load", "--out", str(tmp_path / "new")]) == 2
    assert "no effect 'slung_load'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_figure_becomes_a_picture_of_its_lines():
    t = np.linspace(0.0, 3.0, 50)
    gap = np.where(t > 2.0, np.nan, np.sin(t))
    lines = (Trace(t, np.sin(t), "measured", "measured"), Trace(t, gap, "base <model>", "before"))
    flat = Panel("flat", "time, s", "y", (Trace(t, np.zeros(50), "measured", "measured"),))
    svg = ElementTree.fromstring(as_svg(Figure("f", (Panel("a & b", "time, s", "y, m", lines), flat), "caption")))
    found = [e for e in svg.iter() if e.tag.endswith("polyline")]
    assert [len(e.get("points").split()) for e in found] == [50, int((t <= 2.0).sum()), 50]
    numbers = np.array([p.split(",") for e in found for p in e.get("points").split()], dtype=float)
    assert np.isfinite(numbers).all()
    assert (numbers >= 0).all()
    assert (numbers[:, 0] <= 400).all()
    assert [e.text for e in svg.iter() if e.text in ("base <model>", "a & b")] == ["base <model>", "a & b"]
