"""model.yaml goes out and comes back; a bad one lists everything wrong with it."""

from dataclasses import replace

import numpy as np
import pytest

from flighttest.errors import ModelError
from flighttest.identify.free_flight.equation_fit import fit_of_estimates
from flighttest.identify.free_flight.estimated import HeldEstimate
from flighttest.identify.models import model_file
from flighttest.identify.models.compare import compare
from flighttest.physics.model import Model
from tests.identify.campaign import TRUTH


@pytest.fixture
def written(found, tmp_path):
    path = tmp_path / "model.yaml"
    fingerprint = {"components": {"battery": {"id": "B07"}}, "firmware": "x"}
    model_file.write(path, model_file.as_data(found, fingerprint=fingerprint, runs=["a", "b"]))
    return path


def test_what_is_written_is_read_back(found, written):
    stored = model_file.read(written)
    assert stored.model == found.model
    assert stored.runs == ("a", "b")
    assert stored.fingerprint["components"]["battery"]["id"] == "B07"
    for name, value in found.values.items():
        assert stored.values[name] == pytest.approx(value, rel=1e-6)
    at = [stored.order.index(n) for n in found.covariance.names]
    assert np.allclose(stored.covariance[np.ix_(at, at)], found.covariance.matrix, rtol=1e-5)
    assert stored.valid["voltage_v"] == pytest.approx(list(found.valid.voltage_v), rel=1e-5)
    assert set(TRUTH) <= set(stored.parameters)


def test_the_mean_delay_is_in_the_covariance(found, written):
    stored = model_file.read(written)
    k = stored.order.index("T_d")
    assert np.sqrt(stored.covariance[k, k]) == pytest.approx(found.estimates["T_d"].scatter, rel=1e-4)


def test_a_file_with_the_papers_twelve_is_enough(tmp_path):
    path = tmp_path / "paper.yaml"
    rows = "\n".join(f"  {n}: {{value: {v}}}" for n, v in TRUTH.items())
    path.write_text(
        f"format: model/1\nterms: [body, linear_drag]\nparameters:\n{rows}\n"
        "constants: {g: 9.81, nominal_voltage_v: 22.2, rotor_height_m: 0.4}\n"
    )
    stored = model_file.read(path)
    assert not stored.model.channel_delays
    assert stored.model.constants == {"g": 9.81, "nominal_voltage_v": 22.2, "rotor_height_m": 0.4}
    assert stored.delays_s == pytest.approx({"attitude": 0.1037, "yaw_rate": 0.1037, "thrust": 0.1037})


def test_everything_wrong_is_listed_with_its_line(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(
        "format: model/1\nterms: [body, linear_darg]\nparameters:\n  K: {valeu: 3}\n  alpha: {value: x}\nextra: 1\n"
    )
    with pytest.raises(ModelError) as error:
        model_file.read(path)
    lines = {p.line for p in error.value.problems}
    assert {2, 4, 5, 6} <= lines
    assert "did you mean `value`" in str(error.value)


def test_a_missing_file_is_no_traceback(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        model_file.read(tmp_path / "none.yaml")


def test_parameters_of_a_term_must_be_there(tmp_path):
    path = tmp_path / "half.yaml"
    path.write_text("format: model/1\nterms: [body, linear_drag]\nparameters:\n  K: {value: 50}\n")
    with pytest.raises(ModelError, match="d_x"):
        model_file.read(path)


def test_a_model_does_not_differ_from_itself_and_does_from_another(found, written):
    first = model_file.read(written)
    assert not any(d.differs for d in compare(first, first))
    text = written.read_text().replace("K: {value: ", "K: {value: 1")
    written.write_text(text)
    other = compare(first, model_file.read(written))
    assert other[0].name == "K"
    assert other[0].differs
    assert "differs" in other[0].sentence
    assert sum(d.differs for d in other) == 1


def test_gains_are_compared_at_one_voltage(found, written):
    """K (U / U_n)^alpha is the same thrust at either nominal voltage."""
    first = model_file.read(written)
    gain, alpha = first.parameters["K"], first.parameters["alpha"]
    stated = replace(gain, value=gain.value * 0.5**alpha.value)
    half = replace(first.model, nominal_voltage_v=0.5 * first.model.nominal_voltage_v)
    other = replace(first, model=half, parameters={**first.parameters, "K": stated})
    row = next(d for d in compare(first, other) if d.name == "K")
    assert row.second == pytest.approx(gain.value)
    assert not row.differs


def left_row(**changed):
    """A line on what a model's own flights left, with something wrong in it."""
    row = {"channel": "roll_rad", "kind": "roll_step", "cell": "{amplitude_rad: 0.3}", "responses": "2", "first": "0"}
    words = {**row, "variance": "0.1", "mean": "[0.1, null]", **changed}
    return f"diagnosed: {{left: [{{{', '.join(f'{k}: {v}' for k, v in words.items())}}}]}}"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("valid: {voltage_v: [22.1, null]}", "valid.voltage_v"),
        ("valid: {voltage_v: [0, 0]}", "outside 0.1 to 2000"),
        ("constants: {g: heavy}", "constants.g"),
        ("constants: {nominal_voltage_v: 1e300}", "outside 0.1 to 2000"),
        ("constants: {rotor_height_m: -1}", "outside 0 to 5"),
        ("noise: {channels: {roll_rad: loud}}", "noise.channels.roll_rad"),
        ("noise: [1, 2]", "expected a block of keys"),
        ("runs: 5", "expected a list"),
        ("runs: [a, .inf]", "expected text, found a number"),
        ("fingerprint: {components: {propellers: -1}}", "fingerprint.components.propellers"),
        ("fingerprint: {shaping_parameters: [[1]]}", "fingerprint.shaping_parameters"),
        ("fingerprint: {shaping_parameters: {MOT_SPIN_MIN: low}}", "expected a number"),
        ("fingerprint: {mass_kg: heavy}", "fingerprint.mass_kg"),
        ("fit_quality: good", "expected a block of keys"),
        ("covariance: {order: [alpha], matrix: [[-1.0]]}", "negative variance"),
        ("covariance: {order: [banana], matrix: [[1.0]]}", "names banana, which are no parameters"),
        (
            "covariance: {order: [alpha, alpha], matrix: [[1.0, 0.0], [0.0, 1.0]]}",
            "names alpha, which stand there twice",
        ),
        ("covariance: {order: [alpha, alpha], matrix: [[1.0, 0.5], [0.0, 1.0]]}", "not symmetric"),
        ('attitude_loops: "false"', "expected true or false"),
        ("covariance: {order: 5, matrix: [[1.0]]}", "the matrix is not 0 x 0 numbers"),
        (f"covariance: {{order: [alpha], matrix: [[1{'0' * 350}]]}}", "cannot make sense of"),
        ("fit_quality: {hover: {throttle: .nan}}", "not a finite number"),
        ("fit_quality: {motors: {shares: [1, 1, one, 1]}}", "expected a number"),
        ("fit_quality: {flown_steps: [1]}", "expected a block of keys"),
        ("fit_quality: {flown_steps: {roll: 3}}", "expected a list"),
        (
            "fit_quality: {flown_steps: {roll: [{size: 0.3, period_s: 0.02, answer: []}]}}",
            "answer: this key is missing",
        ),
        ("fit_quality: {flown_steps: {roll: [{size: 0, period_s: 0.02, answer: [0.1]}]}}", "size: 0 is outside"),
        ("fit_quality: {flown_steps: {roll: [{size: 1, period_s: -1, answer: [0.1]}]}}", "period_s: -1 is outside"),
        (
            "fit_quality: {flown_steps: {roll: [{size: 1, period_s: 0.02, voltage_v: -3, answer: [0.1]}]}}",
            "-3 is outside 0.1 to 2000",
        ),
        ("diagnosed: {verdict: [EXPLAINED]}", "expected text"),
        ("diagnosed: {untestable: 7}", "expected a list"),
        ("diagnosed: {smallest_detectable: 0.1}", "expected a block of keys"),
        ("diagnosed: {left: {roll: 1}}", "expected a list"),
        ("diagnosed: {left: [{channel: roll_rad}]}", "mean: this key is missing"),
        (left_row(variance="-1"), "-1 is outside"),
        (left_row(mean="[0.1, a]"), "expected a number"),
        (left_row(cell="{amplitude_rad: a}"), "expected a number"),
        (left_row(cell="{amplitude_rad: null}"), "expected a number"),
        (left_row(channel="[roll_rad]"), "expected text"),
    ],
)
def test_nonsense_in_any_block_is_reported_with_its_line(tmp_path, line, words):
    path = tmp_path / "bad.yaml"
    path.write_text(f"format: model/1\nterms: [body]\nparameters: {{alpha: {{value: 1.7}}}}\n{line}\n")
    with pytest.raises(ModelError, match=words) as error:
        model_file.read(path)
    assert {p.line for p in error.value.problems} == {4}


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("alhpa: {value: 1.7}", "did you mean alpha"),
        ("alpha: {value: 1.7, interval_95: [1.8, 1.6]}", "two rising numbers"),
        ("alpha: {value: 1.7, interval_95: [.nan, 1.6]}", "two rising numbers"),
        (f"alpha: {{value: 1.7, interval_95: [1, 1{'0' * 350}]}}", "two rising numbers"),
        ('alpha: {value: 1.7, identifiable: "false"}', "expected true or false"),
        ("T_d: {value: 100, unit: ms, source: frozen}", "T_d is in s, not in ms"),
        ("K: {value: -50, source: frozen}", "K is above zero"),
    ],
)
def test_a_parameter_that_would_be_misread_is_refused(tmp_path, entry, words):
    path = tmp_path / "bad.yaml"
    path.write_text(f"format: model/1\nterms: [body]\nparameters:\n  {entry}\n")
    with pytest.raises(ModelError, match=words):
        model_file.read(path)


def test_what_is_flown_or_exported_must_be_whole(tmp_path):
    path = tmp_path / "k.yaml"
    path.write_text("format: model/1\nterms: [body]\nparameters: {K: {value: 50, unit: m/s^2}}\n")
    assert model_file.read(path).values["K"] == 50
    with pytest.raises(ModelError, match="sigma_t, alpha of its terms are missing"):
        model_file.read(path, whole=True)


def test_a_fit_that_no_fit_can_have_found_is_refused(tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text("format: model/1\nterms: [body]\nparameters:\n  K: {value: -50}\n  alpha: {value: 1.7}\n")
    with pytest.raises(ModelError, match=r"4: parameters.K: -50 is outside 1 to 2000"):
        model_file.read(path)
    path.write_text("format: model/1\nterms: [body, 3, [1]]\nparameters: {K: {value: 50}}\n")
    with pytest.raises(ModelError, match="no term is called"):
        model_file.read(path)


@pytest.mark.slow
def test_a_parameter_that_only_prediction_errors_show_does_not_end_the_model_file(flown):
    """The acceleration limit of a shaping was estimated by prediction errors and never reached: it changes nothing in output error, and a
    diagnosis ended in a traceback after 100 s."""
    values = {"shaping_accel": 399.0, "shaping_tc": 0.5, "shaping_ff": 1.0}
    estimate = HeldEstimate(tuple(values), values, np.diag([25.0, 1e-4, 1e-2]), 20.0)
    made = fit_of_estimates(flown, Model(("linear_drag", "reference_shaping")), [estimate])
    normal = made.solution.normal
    assert not normal.hessian[:, normal.names.index("shaping_accel")].any()
    entry = model_file.as_data(made)["parameters"]["shaping_accel"]
    assert (entry["value"], entry["std"]) == pytest.approx((399.0, 5.0))
