"""`flighttest twin`: wrong inputs get one sentence, and a comparison its verdict."""

from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.cli.main import call
from flighttest.errors import InputError, LinkError, ModelError
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.physics.model import Model
from flighttest.pipeline import twin
from flighttest.pipeline.vehicles import simulator
from flighttest.report.sections.twin import verify_sections, verify_sentence


def stored(**options):
    model = Model(**options)
    values = model.start()
    parameters = {n: StoredParameter(values[n], model.param[n].unit, 0.01 * values[n]) for n in model.names}
    return ModelFile(model, parameters, values, (), np.zeros((0, 0)), {}, path="model.yaml")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either --verify RUN... or --replay RUN..."),
        (["--verify", "a", "--replay", "b"], "either --verify RUN... or --replay RUN..."),
        (["--replay", "a", "--backend", "sitl"], "--backend works with --verify only"),
        (["--verify", "a", "--set", "K=1"], "--set works with --replay only"),
    ],
)
def test_what_is_asked_is_one_thing(tmp_path, capsys, words, said):
    model = tmp_path / "model.yaml"
    model.write_text("")
    assert call(["twin", str(model), *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("work", [lambda: twin.verify("m", []), lambda: twin.replay("m", [])])
def test_a_model_without_attitude_loops_has_no_twin(monkeypatch, work):
    monkeypatch.setattr(twin.model_file, "read", lambda *_args, **_more: stored(attitude_loops=False))
    monkeypatch.setattr(twin, "check_writable", lambda _folder: None)
    with pytest.raises(ModelError, match="has no attitude loops"):
        work()


def test_under_the_real_firmware_a_model_hides_nothing():
    with pytest.raises(InputError, match="a model under the real firmware flies without further effects"):
        next(simulator.serve(simulator.Served(backend="sitl", hide=("swirl",), model="model.yaml")))


def test_without_the_firmware_that_is_said_first(monkeypatch):
    def none():
        raise LinkError("no ArduPilot SITL here", "build one")

    monkeypatch.setattr(simulator, "find_arducopter", none)
    with pytest.raises(LinkError, match="no ArduPilot SITL here"):
        next(simulator.serve(simulator.Served(backend="sitl", model="model.yaml")))


def diagnosed(fit, model):
    """A diagnosis that names nothing."""
    return SimpleNamespace(
        fit=fit,
        model=model,
        accepted=(),
        untestable=(),
        noise_floor={},
        sentence="-",
        verdict=SimpleNamespace(name="-"),
    )


@pytest.mark.parametrize(
    ("ratio", "change", "verdict"), [(1.0, 0.0, "NOTHING_MISSING"), (3.0, 0.0, "DIFFERS"), (1.0, 0.3, "DIFFERS")]
)
def test_the_verdict_is_of_every_channel_and_parameter(monkeypatch, ratio, change, verdict):
    file = stored()
    values = dict(file.values) | {"K": file.values["K"] * (1.0 + change)}
    quality = SimpleNamespace(rmse=ratio * 0.1, floor=0.1)
    fit = SimpleNamespace(quality={"f_z_m_s2": SimpleNamespace(rmse=0.1, floor=0.1)}, noise=None, values=values)
    found = diagnosed(fit, file.model)
    errors = {n: (0.01 * file.values[n], 30.0) for n in file.model.names}
    monkeypatch.setattr(twin, "prediction_quality", lambda *_: {"f_z_m_s2": quality})
    monkeypatch.setattr(twin, "side_of", lambda _fit, _found: twin.Side(file.model, values, errors))
    data = twin.compare_with_recordings(file, [], found, ())
    data |= {"flights": 0, "assumed": []}
    assert data["verdict"] == verdict
    said = verify_sentence(data)
    assert said.startswith(
        "The twin flies as recorded." if verdict == "NOTHING_MISSING" else "The twin does not fly as recorded:"
    )
    if ratio > 2:
        assert "above 1.2 noise floors in specific force up 3.00" in said
    if change:
        assert "K differs" in said
    assert [s.id for s in verify_sections(data)] == ["picture", "channels", "parameters"]


def test_flying_is_offline_or_under_the_firmware():
    with pytest.raises(InputError, match="--offline flies nothing"):
        twin.Flying(offline=True, firmware=True).check()


def test_without_the_firmware_no_recording_is_read(monkeypatch):
    def none():
        raise LinkError("no ArduPilot SITL here", "build one")

    monkeypatch.setattr(twin, "find_arducopter", none)
    monkeypatch.setattr(twin.model_file, "read", lambda *_args, **_more: stored())
    with pytest.raises(LinkError, match="no ArduPilot SITL here"):
        twin.verify("m", [], flying=twin.Flying(firmware=True))


def test_under_the_firmware_steps_are_judged_as_flown(monkeypatch):
    """The model's own error in roll does not count there, that of the flown steps does."""
    file = stored()
    quality = {"roll_rad": SimpleNamespace(rmse=0.5, floor=0.1)}
    fit = SimpleNamespace(quality=quality, noise=None, values=file.values)
    found = diagnosed(fit, file.model)
    errors = {n: (0.01 * file.values[n], 30.0) for n in file.model.names}
    monkeypatch.setattr(twin, "prediction_quality", lambda *_: quality)
    monkeypatch.setattr(twin, "side_of", lambda _fit, _found: twin.Side(file.model, file.values, errors))
    for ratio, verdict in ((1.1, "NOTHING_MISSING"), (1.3, "DIFFERS")):
        row = {"rmse": ratio, "floor": 1.0, "ratio": ratio, "later_s": 0.0, "later_std_s": 0.001, "steps": 4}
        monkeypatch.setattr(twin, "flown_errors", lambda *_, row=row: {"roll_rad": row})
        data = twin.compare_with_recordings(file, [], found, (), firmware=True)
        assert data["verdict"] == verdict
        assert twin.compare_with_recordings(file, [], found, ())["verdict"] == "DIFFERS"
        data |= {"flights": 1, "assumed": [], "backend": "sitl"}
        assert f"{ratio:.2f}" in verify_sentence(data)
        assert len(verify_sections(data)[1].blocks) == 2


@pytest.mark.parametrize(
    ("firmware", "pole", "lacks"), [(True, 0.05, []), (True, 0.15, []), (False, 0.05, ["attitude_extra_pole"])]
)
def test_a_term_of_the_loops_is_looked_for_in_what_flew_under_the_firmware(monkeypatch, firmware, pole, lacks):
    """The loops that fly there are the firmware's: that the model has no third pole does not mean that the twin has none."""
    file = stored()
    model = file.model.with_terms("attitude_extra_pole")
    values = model.start(file.values) | {"attitude_pole_tau": 0.05, "attitude_pole_share": 0.5}
    real = SimpleNamespace(quality={}, noise=None, values=values)
    found = diagnosed(real, model)
    found.accepted = ("attitude_extra_pole",)
    errors = {n: (0.01 * abs(values[n]) + 1e-6, 30.0) for n in model.names}
    monkeypatch.setattr(twin, "prediction_quality", lambda *_: {})
    monkeypatch.setattr(twin, "side_of", lambda _fit, _found: twin.Side(model, values, errors))
    monkeypatch.setattr(twin, "flown_errors", lambda *_: {})
    monkeypatch.setattr(twin, "step_by_step", lambda *_: ())

    def fitted(_segments, of, **_more):
        flown = {n: values[n] for n in of.names} | (
            {"attitude_pole_tau": pole} if "attitude_pole_tau" in of.names else {}
        )
        return SimpleNamespace(model=of, values=flown)

    monkeypatch.setattr(twin, "fit", fitted)
    monkeypatch.setattr(twin, "errors_of", lambda f: {n: errors[n] for n in f.model.names})
    data = twin.compare_with_recordings(file, [], found, [SimpleNamespace(usable=True)], firmware=firmware)
    assert data["lacks"] == lacks
    assert ("attitude_pole_tau" in data["differing"]) == (pole > 0.1 or not firmware)


@pytest.mark.parametrize("firmware", [True, False])
def test_under_the_firmware_the_delays_are_those_of_the_recorded_runs(monkeypatch, firmware):
    """A target waits up to 2.5 ms for the firmware's next cycle, and all repeats of a run wait alike."""
    file, freed = stored(channel_delays=True), []
    fit = SimpleNamespace(quality={}, noise=None, values=file.values)
    errors = {n: (0.01 * file.values[n] + 1e-6, 30.0) for n in file.model.names}
    monkeypatch.setattr(twin, "prediction_quality", lambda *words: freed.extend(words[4]) or {})
    monkeypatch.setattr(twin, "side_of", lambda _fit, _found: twin.Side(file.model, file.values, errors))
    twin.compare_with_recordings(file, [], diagnosed(fit, file.model), (), firmware)
    assert freed == (["T_d_attitude", "T_d_yaw_rate"] if firmware else [])
