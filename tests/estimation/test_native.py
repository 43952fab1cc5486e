"""The compiled kernel against the same in numpy, and how it is had."""

import casadi as ca
import numpy as np
import pytest

from flighttest.estimation.integration import kernel as kernel_module
from flighttest.estimation.integration import native, native_block
from flighttest.estimation.integration.kernel import Kernel
from flighttest.estimation.integration.native import Program, library
from flighttest.estimation.responses import Response, Stacked
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import Model

needs_compiler = pytest.mark.skipif(library() is None, reason="no C compiler: install gcc or clang")
FILTERED = ("f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "roll_rad", "r_rad_s")


def responses(block, count, rng):
    """Of different lengths, edges between samples, signals of the size of real ones."""
    found = []
    for j in range(count):
        t = 5.0 * j + np.cumsum(rng.uniform(0.01, 0.03, 25 + 9 * j))
        usual = {"voltage_v": 22.0, "height_m": 2.0, "time_s": 60.0}
        signals = [usual.get(n, 0.0) + 0.2 * np.sin(3.0 * t + i) for i, n in enumerate(block.exogenous)]
        e = np.stack(signals, axis=1) if signals else np.empty((t.size, 0))
        edges = t[0] + np.array([-9.0, 0.12 + 0.01 * j, 0.31])
        values = np.tile([[0.2], [0.35], [0.25]], (1, len(block.inputs)))
        n = len(block.free_states)
        found.append(Response(j, t, np.zeros((t.size, 1)), edges, values, e, np.zeros(n), np.ones(n)))
    return found


def both_ways(monkeypatch, block, free, hz, sensitivities=True):
    """(outputs, derivatives) compiled, then in numpy, of some responses: more than are integrated at once, and no multiple of it."""
    rng = np.random.default_rng(7)
    some = responses(block, native_block.LANES + 3, rng)
    known = Model().with_terms(*catalogue()).start()
    p = np.array([known[n] for n in block.params])
    nodes = Stacked.of(some).nodes(float(block.delay_s(p)), 0.012)
    mask = rng.random((len(some), max(r.t_s.size for r in some), len(block.outputs))) > 0.1
    for j, r in enumerate(some):
        mask[j, r.t_s.size :] = False
    integrator = Kernel(block, block.outputs, free, {n: 18.0 for n in block.outputs if n in hz})
    local = 0.1 * rng.standard_normal((len(some), len(integrator.locals)))
    if block.name == "translation":
        local[:, 3] += 10.0
    first = integrator.at_samples(p, local, nodes, mask, sensitivities)
    monkeypatch.setattr(kernel_module, "library", lambda: None)
    return first, integrator.at_samples(p, local, nodes, mask, sensitivities)


@needs_compiler
@pytest.mark.parametrize("model", [Model(), Model().with_terms(*catalogue())], ids=["base", "catalogue"])
@pytest.mark.parametrize("hz", [(), FILTERED], ids=["raw", "filtered"])
def test_compiled_outputs_and_derivatives_are_those_of_numpy(monkeypatch, model, hz):
    for block in model.blocks:
        with monkeypatch.context() as patch:
            (y, dy), (y_numpy, dy_numpy) = both_ways(patch, block, block.params, hz)
        assert np.allclose(y, y_numpy, rtol=1e-11, atol=1e-12)
        scale = np.abs(dy_numpy).max(axis=(0, 1)) + 1e-9
        assert np.abs((dy - dy_numpy) / scale).max() < 1e-10, block.name
        assert np.abs(dy).max() > 0.0


@needs_compiler
def test_compiled_outputs_alone_are_those_of_numpy(monkeypatch):
    block = next(b for b in Model().blocks if b.name == "translation")
    (y, dy), (y_numpy, _) = both_ways(monkeypatch, block, (), FILTERED, sensitivities=False)
    assert dy.shape[-1] == 0
    assert np.allclose(y, y_numpy, rtol=1e-12, atol=1e-12)


@needs_compiler
def test_responses_have_parameters_of_their_own(monkeypatch):
    block = next(b for b in Model().blocks if b.name == "translation")
    rng, known = np.random.default_rng(5), Model().start()
    some = responses(block, 5, rng)
    p = np.tile([known[n] for n in block.params], (5, 1))
    p[:, block.params.index("K")] *= [1.0, 1.1, 0.9, 1.0, 1.2]
    nodes = Stacked.of(some).nodes(float(block.delay_s(p[0])), 0.012)
    mask = np.ones((5, max(r.t_s.size for r in some), len(block.outputs)), dtype=bool)
    integrator = Kernel(block, block.outputs, block.params)
    local = 0.1 * rng.standard_normal((5, len(integrator.locals)))
    y, dy = integrator.at_samples(p, local, nodes, mask, True)
    for j in range(5):
        alone, slopes = integrator.at_samples(p[j], local, nodes, mask, True)
        assert np.array_equal(y[j], alone[j])
        assert np.array_equal(dy[j], slopes[j])
    monkeypatch.setattr(kernel_module, "library", lambda: None)
    y_numpy, dy_numpy = integrator.at_samples(p, local, nodes, mask, True)
    assert np.allclose(y, y_numpy, rtol=1e-11, atol=1e-12)
    assert np.abs((dy - dy_numpy) / (np.abs(dy_numpy).max(axis=(0, 1)) + 1e-9)).max() < 1e-10


@needs_compiler
def test_a_simulation_that_diverges_is_not_finite(monkeypatch):
    block = next(b for b in Model().blocks if b.name == "roll")
    (response,) = responses(block, 1, np.random.default_rng(1))
    p = np.array([{"omega_phi": 1e6}.get(n, 0.1) for n in block.params])
    nodes = Stacked.of([response]).nodes(0.1)
    mask = np.ones((1, response.t_s.size, 1), dtype=bool)
    y, dy = Kernel(block, block.outputs, block.params).at_samples(p, np.zeros((1, 3)), nodes, mask, True)
    assert not np.isfinite(y).all()
    assert not np.isfinite(dy).all()


@needs_compiler
def test_threads_share_the_responses(monkeypatch):
    block = Model().blocks[-1]
    rng, known = np.random.default_rng(3), Model().start()
    some = responses(block, 2 * native_block.LEAST_GROUPS * native_block.LANES + 3, rng)
    p = np.array([known[n] for n in block.params])
    nodes = Stacked.of(some).nodes(float(block.delay_s(p)), 0.012)
    mask = np.ones((len(some), max(r.t_s.size for r in some), len(block.outputs)), dtype=bool)
    integrator = Kernel(block, block.outputs, block.params, {})
    local = 0.1 * rng.standard_normal((len(some), len(integrator.locals)))
    found = []
    for cores in (1, 2, 3):
        monkeypatch.setattr(native_block, "usable_cores", lambda cores=cores: cores)
        found.append(integrator.at_samples(p, local, nodes, mask, True))
    assert np.abs(found[0][0][-1]).max() > 0.0
    for y, dy in found[1:]:
        assert np.array_equal(y, found[0][0])
        assert np.array_equal(dy, found[0][1])


def test_groups_are_those_of_the_kernel():
    assert f"#define LANES {native_block.LANES}\n" in native.SOURCE.read_text()


def test_nodes_of_many_responses_are_those_of_each():
    block = next(b for b in Model().blocks if b.name == "translation")
    some = responses(block, 5, np.random.default_rng(2))
    together = Stacked.of(some).nodes(0.0831, 0.007)
    for j, response in enumerate(some):
        alone = Stacked.of([response]).nodes(0.0831, 0.007)
        a, b = together.first[j : j + 2]
        assert np.array_equal(together.rows[a:b], alone.rows)
        assert np.array_equal(together.target[a:b], alone.target)
        assert alone.target[alone.sample].tolist() == list(range(response.t_s.size))


def test_the_last_edge_counts_where_the_first_one_lies_inside():
    t = np.arange(50) * 0.02
    response = Response(
        0, t, np.zeros((50, 1)), np.array([0.105, 0.505]), np.array([[0.2], [0.4]]), np.empty((50, 0)), t[:1], t[:1]
    )
    nodes = Stacked.of([response]).nodes(0.1)
    assert nodes.rows[nodes.sample[-1], 1] == 0.4
    assert nodes.rows[nodes.sample[20], 1] == 0.2
    assert nodes.rows[0, 1] == 0.2


def test_an_operation_that_is_not_known_is_refused():
    arguments = [ca.SX.sym(n) for n in "xpued"]
    with pytest.raises(ValueError, match="not known to the compiled kernel"):
        Program.of(ca.Function("f", arguments, [ca.erf(arguments[0])]))


def test_without_a_compiler_there_is_no_library(monkeypatch):
    monkeypatch.setattr(native.shutil, "which", lambda name: None)
    assert library.__wrapped__() is None


def test_a_compiler_that_fails_is_done_without(monkeypatch, tmp_path):
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(native.shutil, "which", lambda name: str(broken))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert library.__wrapped__() is None
    assert list((tmp_path / "cache/flighttest").iterdir()) == []


@pytest.mark.slow
@needs_compiler
def test_a_c_library_without_vector_functions_is_done_with(monkeypatch, tmp_path):
    monkeypatch.setattr(native, "LIBRARIES", (("-lno_such_library",), native.LIBRARIES[-1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plain = library.__wrapped__()
    assert plain is not None
    monkeypatch.setattr(native_block, "library", lambda: plain)
    block = next(b for b in Model().blocks if b.name == "translation")
    (y, dy), (y_numpy, dy_numpy) = both_ways(monkeypatch, block, block.params, ())
    assert np.allclose(y, y_numpy, rtol=1e-11, atol=1e-12)
    assert np.allclose(dy, dy_numpy, rtol=1e-9, atol=1e-9 * np.abs(dy_numpy).max())


def test_a_cache_that_cannot_be_written_is_done_without(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(native.shutil, "which", lambda name: "/bin/sh")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert library.__wrapped__() is None
