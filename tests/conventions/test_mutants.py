"""Changes that passed every test once, and the tool that makes them."""

import ast

import pytest

from tests.mutants import CONDITIONS, CONSTANTS, ROOT, Mutant, copied, mutants, passes, place, survives

NOTICED = (
    ("flight/gate.py", "target.yaw_rate_rad_s == 0.0 is True"),
    ("diagnose/selection/subsets.py", "ABSORBED = 0.002 for 0.001"),
)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return copied(tmp_path_factory.mktemp("copy"))


def test_a_change_replaces_its_place_alone():
    source = "a = 1\nb = 'ä' if c < 2 else d\n"
    at = place(ast.parse(source).body[1].value.test)
    assert Mutant("m.py", at, "True", "", ()).applied(source) == "a = 1\nb = 'ä' if True else d\n"


def test_every_module_that_decides_has_changes_and_each_makes_a_program():
    found = mutants([])
    assert {m.module for m in found} == {*CONDITIONS, *CONSTANTS}
    sources = {m.module: (ROOT / "flighttest" / m.module).read_text(encoding="utf-8") for m in found}
    for mutant in found:
        made = mutant.applied(sources[mutant.module])
        assert made != sources[mutant.module]
        ast.parse(made)


@pytest.mark.slow
def test_without_tests_a_change_survives(project):
    some = mutants(["flight/gate.py"])[0]
    assert survives(Mutant(some.module, some.at, some.text, some.what, ("tests/mavlink/test_clock.py",)), project)


@pytest.mark.slow
@pytest.mark.parametrize(("module", "what"), NOTICED)
def test_what_passed_every_test_once_is_noticed(project, module, what):
    (mutant,) = [m for m in mutants([module]) if m.what.endswith(what)]
    assert not survives(mutant, project)


@pytest.mark.slow
def test_tests_that_cannot_run_are_no_catch(project):
    with pytest.raises(RuntimeError, match="did not run"):
        passes(project, ("tests/no_such_test.py",))
