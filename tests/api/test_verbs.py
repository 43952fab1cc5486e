"""The verbs on a recording of a real autopilot: the same answers as the command line, as records, tables and figures."""

import json

import numpy as np
import pytest

import flighttest as ft
from flighttest.report.render.plotly_figure import LIGHT


def test_a_recording_is_a_table_and_a_figure(log):
    frame = log.to_frame("attitude")
    t_s, roll = log.channel("roll_rad")
    assert np.array_equal(frame.index, t_s)
    assert np.array_equal(frame["roll_rad"], roll)
    whole = log.to_frame()
    assert whole.index.is_monotonic_increasing
    assert whole["roll_rad"].count() == np.isfinite(roll).sum()
    assert [t.name for t in log.plot("attitude").data] == ["roll_rad", "pitch_rad", "yaw_rad"]
    with pytest.raises(ft.RecordingError, match="no group 'attitudes'; there are"):
        log.plot("attitudes")


def test_responses_are_those_of_the_command(log, repository):
    found = ft.segment(log)
    assert len(found.usable) == len(found.segments) == 6
    frame = found.to_frame()
    assert list(frame.index) == [s.name for s in found.segments]
    assert frame["amplitude_rad"].abs().max() == pytest.approx(0.5)
    assert len(found.plot().data) == 6
    assert ft.segment(repository / "tests" / "data" / "sitl_roll_pitch.tlog.xz").sentence == found.sentence


def test_a_fit_is_a_sentence_a_table_a_figure_and_a_model(fitted, tmp_path):
    assert fitted.good
    assert str(fitted) == fitted.sentence == fitted.document.verdict
    row = fitted.to_frame().loc["omega_phi"]
    assert row["value"] == fitted.parameters["omega_phi"].value
    assert row["low_95"] < row["value"] < row["high_95"]
    colours = {t.line.color for t in fitted.plot("figure4").data}
    assert {LIGHT["measured"], LIGHT["simulated"]} <= colours
    with pytest.raises(ft.InputError, match="no figure 'figure5'; there are figure4"):
        fitted.plot("figure5")
    assert "K" in str(fitted.model.equations())
    assert fitted.write_page(tmp_path / "page.html").stat().st_size > 1000


def test_a_model_goes_to_a_file_and_comes_back(fitted, tmp_path):
    again = ft.read_model(fitted.model.write(tmp_path / "model.yaml"))
    assert again.values == pytest.approx(fitted.model.values, rel=1e-6)
    assert again.stored.fingerprint == fitted.model.stored.fingerprint
    assert again.data == fitted.model.data
    assert ft.read_model(tmp_path).values == again.values
    assert (tmp_path / "out" / "model.json") in again.export("json", tmp_path / "out")
    assert len(again.plot().data) == len({p.unit for p in again.parameters.values()})
    for wrong in (lambda: again.export("matlab", tmp_path), lambda: ft.read_model(tmp_path / "out")):
        with pytest.raises(ft.InputError, match=r"matlab|holds no model"):
            wrong()


def test_what_is_held_and_tied_stays_so(log):
    found = ft.fit(log, model=ft.Model() - "linear_drag", freeze={"K": 60.0}, tie={"omega_theta": "omega_phi"})
    assert found.model.values["K"] == 60.0
    assert found.model.values["omega_theta"] == found.model.values["omega_phi"]
    assert "d_x" not in found.parameters
    with pytest.raises(ft.InputError, match="tied twice, or to one that is tied itself"):
        ft.fit(log, tie={"d_y": "d_x", "d_z": "d_y"})


def test_a_model_is_valid_for_the_flight_it_was_fitted_to(log, fitted):
    found = ft.check_validity(log, model=fitted.model)
    assert found.verdict.name == "CURRENT"
    assert found.fly == ()
    assert set(found.to_frame()["subset"]) == {t.subset for t in found.assessment.tests}
    assert len(found.plot().data) == 1


@pytest.mark.slow
def test_validation_compares_the_model_with_its_simplifications(log, fitted):
    found = ft.validate(fitted.model, log)
    frame = found.to_frame()
    assert set(frame["horizon_s"]) <= {0.1, 0.5, 1.0, 1.5, 3.0}
    assert (frame["rmse"] >= 0.0).all()
    assert found.plot().data


def test_a_plan_is_what_check_prints(tmp_path):
    found = ft.plan("yaw_rate")
    assert found.ok
    assert len(found.to_frame()) == len(found.plans[0].legs)
    assert max(max(t.y) for t in found.plot().data) == pytest.approx(2.0)
    from flighttest.cli.main import call

    assert call(["check", "yaw_rate", "--json"]) == 0
    assert found.sentence.startswith("yaw_rate: all 8 steps")


def test_terms_are_found_by_name_and_by_attribute():
    assert ft.terms.ground_effect is ft.terms["ground_effect"]
    assert (ft.Model() + ft.terms.ground_effect).terms[-1] == "ground_effect"
    assert "ground_effect" in dir(ft.terms)
    assert list(ft.terms.to_frame().index) == list(ft.terms)
    with pytest.raises(AttributeError, match="did you mean 'ground_effect'"):
        ft.terms.ground_efect  # noqa: B018


def test_a_model_is_accepted_and_in_use(fitted, tmp_path):
    (tmp_path / "runs").mkdir()
    assert ft.models(tmp_path / "runs").to_frame().empty
    with pytest.raises(ft.InputError, match="no model of any vehicle is in use"):
        ft.models(tmp_path / "runs").in_use()
    kept = fitted.model.write(tmp_path / "model.yaml")
    found = ft.accept(kept, runs=tmp_path / "runs")
    assert list(found.to_frame()["in_use"]) == [True]
    assert ft.models(tmp_path / "runs").in_use().values == pytest.approx(fitted.model.values, rel=1e-6)
    assert len(found.plot().data) == len(fitted.model.parameters)


def test_a_real_vehicle_flies_only_where_that_is_said(tmp_path):
    with pytest.raises(ft.InputError, match=r"may be a real vehicle.*give arm=True"):
        ft.fly("thrust", connect="udpin:127.0.0.1:1", runs=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_simulated_vehicle_is_reached_at_its_url_and_ends_with_its_block():
    with ft.simulate("rotor", hide={"ground_effect": {}}) as vehicle:
        assert vehicle.url.startswith("tcp:127.0.0.1:")
        assert vehicle.alive
    assert not vehicle.alive
    with pytest.raises(ft.InputError, match="airframe"):
        ft.simulate("heptacopter")


def test_an_identified_model_flies(fitted):
    with ft.simulate(model=fitted.model) as vehicle:
        assert vehicle.alive
        assert vehicle.options.seed == 1


def test_errors_are_typed_and_say_what_to_do():
    with pytest.raises(ft.RecordingError) as caught:
        ft.read("nowhere.BIN")
    assert caught.value.hint
    with pytest.raises(ft.InputError, match="no recording was given"):
        ft.fit()


def test_the_light_palette_is_the_pages(repository):
    text = (repository / "flighttest" / "report" / "render" / "figures.js").read_text()
    light = text[text.index("const light") : text.index("const dark")]
    for name, colour in LIGHT.items():
        if isinstance(colour, str):
            assert f'{name}: "{colour}"' in light
    assert json.dumps(LIGHT["heat"]) in light


def test_what_an_interactive_session_shows_is_one_line(log, fitted, tmp_path):
    with ft.simulate("rotor") as vehicle:
        shown = [repr(vehicle)]
    run = ft.Model().simulate({"t_s": [0.0, 0.1], "throttle": [0.2, 0.2]})
    shown += map(repr, (log, log.series["attitude"], ft.segment(log), fitted, fitted.model, ft.Model(), ft.terms, run))
    shown += [repr(ft.terms.ground_effect), repr(ft.plan("yaw_rate"))]
    assert [text for text in shown if "\n" in text or not text.startswith("<") or len(text) > 700] == []
    assert repr(ft.Model() + "ground_effect") == "<Model body + linear_drag + ground_effect: 15 parameters>"
    assert f"{len(log.markers)} markers" in repr(log)


@pytest.mark.slow
def test_concealed_effects_are_given_as_values_or_as_words():
    for hide in ({"ground_effect": {"R2_m2": 0.1}}, ["ground_effect:R2_m2=0.1"], "ground_effect:R2_m2=0.1"):
        with ft.simulate("rotor", hide=hide) as vehicle:
            assert vehicle.options.hide == {"ground_effect": {"R2_m2": 0.1}}


@pytest.mark.slow
def test_the_weather_is_of_all_flights_or_of_those_that_are_named(log):
    for weather in ("still", {"": "still"}, {log.name[:3]: "still"}):
        assert ft.fit(log, weather=weather).good
    with pytest.raises(ft.InputError, match="no flight has this in its name; the flights are"):
        ft.fit(log, weather={"another": "still"})
    with pytest.raises(ft.InputError, match="weather 'calm' is not known"):
        ft.fit(log, weather="calm")


def test_a_list_of_recordings_is_refused_with_what_to_write(log):
    with pytest.raises(ft.InputError, match=r"a list is not a recording; give each .* as \*runs"):
        ft.fit([log])


def test_models_are_compared_and_planned_with_as_values(fitted, tmp_path):
    path = fitted.model.write(tmp_path / "model.yaml")
    assert ft.compare(fitted.model, path).differing == ()
    assert ft.plan("yaw_rate", model=fitted.model).to_frame().equals(ft.plan("yaw_rate", model=path).to_frame())


def test_wrong_models_channels_and_terms_are_one_clear_error(log, fitted, tmp_path):
    wrong = {
        "'model.yaml' is not a model; give": lambda: ft.fit(log, model="model.yaml"),
        "a Model is not a fitted model; give": lambda: ft.diagnose(log, model=ft.Model()),
        "unknown channel 'rol_rad'; did you mean 'roll_rad'": lambda: log.channel("rol_rad"),
        "unknown channel 'nonsense'; see": lambda: log.has("nonsense"),
    }
    for message, call in wrong.items():
        with pytest.raises(ft.FlighttestError, match=message):
            call()
    with pytest.raises(TypeError, match="unsupported operand"):
        ft.Model() + 3
    assert ft.fit(log, model=fitted.model).parameters.keys() == fitted.parameters.keys()


def test_the_options_of_a_simulated_vehicle_are_typed():
    from dataclasses import fields
    from inspect import signature

    from flighttest.api.inputs import SimulateOptions
    from flighttest.sim import SimOptions

    named = set(signature(ft.simulate).parameters) - {"options", "port"}
    assert named | set(SimulateOptions.__annotations__) == {field.name for field in fields(SimOptions)}
