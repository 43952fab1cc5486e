"""One value and one interval per parameter, wherever a diagnosis prints it."""

import pytest

from flighttest.diagnose import diagnose
from flighttest.identify.models import model_file
from flighttest.pipeline.diagnosis import diagnose as diagnosis
from tests.diagnose.flight import campaign, fly


@pytest.fixture(scope="module")
def windy():
    segments = fly(campaign(2, throttles=False, yaws=False), seed=7, wind=(2.5, -1.0, 0.0))
    return segments, diagnose(segments, only=("steady_wind",))


def test_table_findings_and_model_file_hold_the_same(windy, tmp_path, monkeypatch):
    segments, found = windy
    monkeypatch.setattr(diagnosis, "run_document", lambda *_, **_more: None)
    monkeypatch.setattr(diagnosis.html, "write_html", lambda *_: None)
    written, _ = diagnosis.write_diagnosis(found, segments, [], None, None, tmp_path)
    stored = model_file.read(tmp_path / "model.yaml").parameters
    assert {"K", "d_x", "w_north", "w_west"} <= set(found.after)
    for name, row in found.after.items():
        assert stored[name].value == pytest.approx(row["value"], rel=1e-6), name
        if row.get("at_bound"):
            continue
        assert stored[name].std == pytest.approx(row["std"], rel=1e-6), name
        assert stored[name].interval_95 == pytest.approx(row["interval_95"], rel=1e-6), name
    assert {n: r["value"] for n, r in found.after.items()} == {n: found.values[n] for n in found.after}
    for finding in found.findings:
        assert set(finding.parameters) == {"w_north", "w_west", "w_up"} & set(found.after)
        for name, row in finding.parameters.items():
            assert row == found.after[name]
    assert written["after"] == found.to_json()["after"]
