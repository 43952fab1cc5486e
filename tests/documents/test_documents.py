from hypothesis import example, given, settings
from hypothesis import strategies as st

from flighttest.channels import CHANNELS
from flighttest.documents import YamlDocument, nearest, write_text

plain = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(10**9), 10**9),
        st.floats(allow_nan=False, allow_infinity=False),
        st.text(),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(min_size=1, max_size=50), inner, max_size=3)
    ),
    max_leaves=10,
)


def test_what_is_written_twice_is_written_out():
    shared = [1, 2]
    text = write_text({"a": shared, "b": shared})
    assert "&" not in text
    document = YamlDocument("f", text)
    assert document.problems == []
    assert document.root.plain() == {"a": [1, 2], "b": [1, 2]}


@example({"a": {"\x85": "b\x85c"}})
@given(st.dictionaries(st.sampled_from("abc"), plain, min_size=1, max_size=3))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_what_is_written_is_read_back(data):
    document = YamlDocument("f", write_text(data))
    assert document.problems == []
    assert document.root.plain() == data


def test_every_value_has_its_line():
    root = YamlDocument("f", "a: 1\nb:\n  - 2\n  - {c: 3}\n").root
    assert root.value["a"].line == 1
    item = root.value["b"].value[1]
    assert (item.line, item.path) == (4, "b[1]")
    assert item.value["c"].path == "b[1].c"


def test_nearest_words():
    assert nearest("throtle", ["throttle", "height"]) == "throttle"
    assert nearest("zzzz", ["throttle", "height"]) is None
    assert nearest("yaw", CHANNELS) == "yaw_rad"
    assert nearest("target_x", CHANNELS) is None  # voltage_v was offered
    assert nearest("stateX", [*CHANNELS, "t_s", "step"]) is None  # step was offered
    assert nearest("stpe", ["step"]) == "step"
    assert nearest("throttel", CHANNELS) == "throttle"
    assert nearest("roll_rda", CHANNELS) == "roll_rad"
    assert nearest("Throttle", CHANNELS) == "throttle"
