import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flighttest.errors import FlighttestError, ScriptError
from flighttest.script.load import KEYS, LIMIT_KEYS, load_script, parse_script
from flighttest.script.model import Script
from flighttest.script.profiles import PROFILES, Duration

# The example of design/formats.md, word for word.
FORMATS = """\
format: maneuver/1
name: thrust
doc: 18 throttle step combinations for sigma_t, K, alpha
identifies: [sigma_t, K, alpha]
mode: GUIDED_NOGPS
rate_hz: 50
throttle_unit: absolute              # absolute | hover (multiples of vehicle.yaml's hover throttle at nominal voltage, fixed for the run)
limits: {tilt_target_max_deg: 35, tilt_abort_deg: 50, throttle: [0.0, 0.6], height_m: [2, 10], speed_max_m_s: 8, voltage_min_v: 21.0}
reset: {to: [0, 0, 5], heading_deg: [0, 90, 180, 270], by: guided, settle_s: 2}
steps:
  - throttle_pair:
      throttle_0: [0.05, 0.10, 0.15]
      throttle_1: [0.20, 0.25, 0.30, 0.35, 0.40]
      hold_0_s: {up_to: 0.6}
      record_1_s: {up_to: 1.5}
  - throttle_pair: {throttle_0: [0.20, 0.25, 0.30], throttle_1: [0.10], hold_0_s: {up_to: 0.8}, record_1_s: {up_to: 1.0}}
repeat: {each: 4, over_voltage_v: [24.5, 21.5], order: interleaved}
"""


def problems(text):
    with pytest.raises(ScriptError) as caught:
        parse_script(text, "s.yaml")
    return caught.value.problems


def step(text):
    return f"format: maneuver/1\nname: x\nsteps:\n  - {text}\n"


def test_the_example_of_the_formats_page():
    script = parse_script(FORMATS)
    assert script.name == "thrust"
    assert script.limits.tilt_target_max_rad == pytest.approx(math.radians(35))
    assert script.limits.throttle == (0.0, 0.6)
    assert script.reset.heading_rad[1] == pytest.approx(-math.pi / 2)  # compass, clockwise
    assert script.repeat.over_voltage_v == (24.5, 21.5)
    first, second = script.steps
    assert first.settings["throttle_1"] == (0.20, 0.25, 0.30, 0.35, 0.40)
    assert first.settings["hold_0_s"] == Duration(0.6, up_to=True)
    assert second.line == 16
    cells = [cell for m in script.steps for cell in PROFILES[m.profile].cells(m.settings, 1.0)]
    assert len(cells) == 18


@pytest.mark.parametrize(
    ("old", "new", "line", "path", "what", "hint"),
    [
        ("format: maneuver/1", "format: maneuver/2", 1, "format", "version 2", "maneuver/1"),
        ("format: maneuver/1", "format: vehicle/1", 1, "format", "maneuver/1", "write"),
        ("format: maneuver/1\n", "", 1, "format", "does not state", "format: maneuver/1"),
        ("rate_hz", "rate_Hz", 6, "rate_Hz", "unknown key", "`rate_hz`"),
        ("rate_hz: 50", "rate_hz: .nan", 6, "rate_hz", "not a finite", ""),
        ("rate_hz: 50", "rate_hz: 50000", 6, "rate_hz", "outside 20 to 400", ""),
        ("rate_hz: 50", "rate_hz: 50 Hz", 6, "rate_hz", "expected a number", "the number alone, in Hz"),
        ("mode: GUIDED_NOGPS", "mode: GUIDED_NOGSP", 5, "mode", "GUIDED_NOGPS only", "write `mode: GUIDED_NOGPS`"),
        ("mode: GUIDED_NOGPS", "mode: OFFBOARD", 5, "mode", "found `OFFBOARD`", "write `mode: GUIDED_NOGPS`"),
        ("mode: GUIDED_NOGPS", "mode:", 5, "mode", "found nothing", "write `mode: GUIDED_NOGPS`"),
        ("tilt_abort_deg: 50", "tilt_abort_deg: 30", 8, "limits.tilt_abort_deg", "not above", "overshoots"),
        ("throttle: [0.0, 0.6]", "throttle: [0.6, 0.0]", 8, "limits.throttle", "not below", "lower number first"),
        ("throttle: [0.0, 0.6]", "throttle: [0, 60]", 8, "limits.throttle[1]", "outside 0 to 1", ""),
        ("speed_max_m_s", "speed_max_mps", 8, "limits.speed_max_mps", "unknown key", "`speed_max_m_s`"),
        ("by: guided", "by: magic", 9, "reset.by", "not one of", "guided, attitude, pilot"),
        ("to: [0, 0, 5]", "to: [0, 0]", 9, "reset.to", "list of 3", ""),
        (
            "- throttle_pair:\n",
            "- throttle_pairs:\n",
            12,
            "steps[0].throttle_pairs",
            "unknown profile",
            "`throttle_pair`",
        ),
        ("0.10, 0.15]", "0.10, yes]", 12, "steps[0].throttle_pair.throttle_0[2]", "expected a number", ""),
        ("0.35, 0.40]", "0.35, 0.70]", 13, "steps[0].throttle_pair.throttle_1", "outside the limits", "change"),
        ("{up_to: 0.6}", "{upto: 0.6}", 14, "steps[0].throttle_pair.hold_0_s.upto", "unknown key", "`up_to`"),
        ("{up_to: 0.6}", "{up_to: -1}", 14, "steps[0].throttle_pair.hold_0_s.up_to", "outside", ""),
        ("each: 4", "each: 2.5", 17, "repeat.each", "whole number", ""),
        ("each: 4", "each: 4, each: 5", 17, "repeat.each", "twice", "line 17"),
        ("order: interleaved", "order: random", 17, "repeat.order", "not one of", "interleaved"),
        ("identifies: [sigma_t, K, alpha]", "identifies: [sigma, K]", 4, "identifies[0]", "not one of", "`sigma_"),
    ],
)
def test_each_mistake_is_named_with_its_place_and_remedy(old, new, line, path, what, hint):
    assert old in FORMATS
    found = problems(FORMATS.replace(old, new, 1))
    assert any(
        p.line == line and p.path == path and what in p.what and hint in p.hint and p.file == "s.yaml" for p in found
    ), "\n".join(map(str, found))


def test_all_problems_at_once_in_the_order_of_the_file():
    text = (
        FORMATS.replace("rate_hz: 50", "rate_hz: fast").replace("by: guided", "by: hand").replace("each: 4", "each: 0")
    )
    found = problems(text)
    assert [p.line for p in found] == [6, 9, 17]
    with pytest.raises(ScriptError) as caught:
        parse_script(text, "s.yaml")
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("s.yaml:6: rate_hz: ")


def test_degrees_may_be_typed():
    script = parse_script(step("attitude_step: {axis: roll, amplitude_deg: [10, 20]}"))
    assert script.steps[0].settings["amplitude_rad"] == pytest.approx((math.radians(10), math.radians(20)))
    both = problems(step("attitude_step: {axis: roll, amplitude_deg: 10, amplitude_rad: 0.2}"))
    assert "both given" in both[0].what


def test_degrees_meant_as_radians_get_a_hint():
    (found,) = problems(step("attitude_step: {axis: roll, amplitude_rad: 20}"))
    assert "outside" in found.what
    assert "amplitude_deg" in found.hint


def test_a_tilt_above_the_scripts_own_limit():
    text = step("attitude_step: {axis: roll, amplitude_rad: 0.8}")
    (found,) = problems(text)
    assert "tilt_target_max_deg 35" in found.what
    assert found.line == 4


@pytest.mark.parametrize(
    ("flown", "path"),
    [
        ("chirp: {input: roll, amplitude_rad: 0.1, from_hz: 1, to_hz: 10, duration_s: 5}", "steps[0].chirp.to_hz"),
        ("3-2-1-1: {axis: roll, amplitude_rad: 0.1, unit_s: 0.05}", "steps[0].3-2-1-1.unit_s"),
    ],
)
def test_what_its_own_targets_are_too_few_for_is_refused(flown, path):
    """At 5 Hz a 3-2-1-1 of 0.05 s left as one step to each side, and a chirp to 5 Hz as one that died away."""
    text = step(flown).replace("format: maneuver/1\n", "format: maneuver/1\nrate_hz: 40\n", 1)
    assert parse_script(text).rate_hz == 40.0
    assert [p.path for p in problems(text.replace("40", "39"))] == [path]


def test_a_missing_setting_says_what_it_is():
    (found,) = problems(step("attitude_step: {axis: roll}"))
    assert found.path == "steps[0].attitude_step.amplitude_rad"
    assert "add `amplitude_rad:`" in found.hint


def test_exponents_are_numbers():
    assert parse_script(step("hover: {duration_s: 5e0}")).steps[0].settings["duration_s"] == 5.0


def test_a_profile_may_stand_alone():
    assert parse_script(step("rest")).steps[0].settings["duration_s"] == 5.0


def test_a_month_of_flying_is_a_slip_of_the_pen():
    text = step("attitude_step: {axis: [roll, pitch], amplitude_rad: [0.1, 0.2, 0.3]}") + "repeat: {each: 200}\n"
    many = text.replace("[0.1, 0.2, 0.3]", "[" + ", ".join(str(0.1 + 0.01 * k) for k in range(30)) + "]")
    assert "responses are more than" in problems(many)[0].what


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n",
        "format: maneuver/1\nsteps: &s [{rest: {}}]\nname: *s\n",
        "[" * 5000,
        "{a: " * 3000,
        "format: maneuver/1\nsteps: !!python/object/apply:os.system ['true']\n",
        "format: maneuver/1\nsteps: !custom 3\n",
        "format: maneuver/1\nrate_hz: " + "9" * 10000 + "\nsteps: [rest]\n",
        "format: maneuver/1\nname: 2026-99-99\nsteps: [rest]\n",
        "? [a, b]\n: 1\n",
        "\t\tx: 1",
        "",
        "just words",
        "- a\n- b\n",
        "key: 'unterminated",
        "a: 1\n" * 120000,
        "\x00\x01",
        "format: maneuver/1\nsteps: [{rest: {duration_s: .inf}}]\n",
        "format: maneuver/1\nsteps: [{rest: null, hover: null}]\n",
        "format: maneuver/1\nsteps:\n",
        "format: maneuver/1\n--- \nformat: maneuver/1\n",
        "<<: {a: 1}\n",
    ],
    ids=range(21),
)
def test_hostile_text_is_refused_in_words(text):
    with pytest.raises(ScriptError) as caught:
        parse_script(text)
    assert str(caught.value)
    assert len(str(caught.value)) < 20000


def test_a_file_that_is_not_there_or_not_text(tmp_path):
    with pytest.raises(ScriptError, match="cannot be read"):
        load_script(tmp_path / "nothing.yaml")
    with pytest.raises(ScriptError, match="cannot be read"):
        load_script(tmp_path)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x9d")
    with pytest.raises(ScriptError, match="UTF-8"):
        load_script(binary)


def outcome(text):
    """The script, or None where it is refused; anything but a FlighttestError is a traceback."""
    try:
        return parse_script(text)
    except FlighttestError:
        return None


@given(st.text(max_size=300))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_no_text_gives_a_traceback(text):
    outcome(text)


scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**12), 10**12),
    st.floats(),
    st.sampled_from(["roll", "both", "hover", "3 s", "GUIDED_NOGPS", "up_to", ""]),
    st.text(max_size=8),
)
settings_keys = sorted({field.key for profile in PROFILES.values() for field in profile.fields})
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from([*settings_keys, "up_to", "x"]), inner, max_size=4)
    ),
    max_leaves=8,
)
steps = st.lists(st.dictionaries(st.sampled_from([*PROFILES, "loop"]), values, min_size=1, max_size=2), max_size=3)
documents = st.fixed_dictionaries(
    {"format": st.one_of(st.just("maneuver/1"), scalars)},
    optional={
        **{key: values for key in KEYS if key not in ("format", "steps", "limits")},
        "steps": st.one_of(steps, values),
        "limits": st.one_of(values, st.dictionaries(st.sampled_from(LIMIT_KEYS), values, max_size=5)),
    },
)


@pytest.mark.slow
@given(documents)
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
def test_no_structure_gives_a_traceback(document):
    import yaml

    yaml.SafeDumper.ignore_aliases = lambda self, data: True
    outcome(yaml.safe_dump(document))


@pytest.mark.slow
@given(st.integers(0, len(FORMATS) - 1), st.text(max_size=3), st.integers(0, 6))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_no_slip_of_the_pen_gives_a_traceback(at, typed, removed):
    found = outcome(FORMATS[:at] + typed + FORMATS[at + removed :])
    assert found is None or isinstance(found, Script)
