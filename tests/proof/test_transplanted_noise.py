"""Noise and disturbance of real flights on simulated ones: whose, in what order, and that force and velocity still belong together."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from flighttest.errors import InputError
from flighttest.frames import G_M_S2
from flighttest.proof import proving, transplanted_noise, trial
from flighttest.proof.board_page import markdown
from flighttest.proof.cases import NoiseSource, cases_of, draw
from flighttest.proof.oracle import STEP_S
from flighttest.proof.outcome import Outcome
from flighttest.proof.prove import ProofRequest, run_trials
from flighttest.proof.recorded.sets import read_sets
from flighttest.proof.scoreboard import score
from flighttest.recording.model import Provenance, Recording, Series

COLUMNS = """format: columns/1
frame: {world: NWU, body: FLU}
columns:
"""
NAMES = (
    "roll_rad", "pitch_rad", "yaw_rad", "p_rad_s", "q_rad_s", "r_rad_s", "roll_ref_rad", "pitch_ref_rad", "yaw_rate_ref_rad_s", "throttle",
    "f_x_m_s2", "f_y_m_s2", "f_z_m_s2", "v_x_m_s", "v_y_m_s", "v_z_m_s",
)  # fmt: skip
GUST_M_S2 = 0.4


def windy(seconds=60.0, seed=3):
    """(n, 17) a hover that a force of 0.4 m/s^2 RMS and 0.2 s pushes northwards, against a controller, and everything else in noise."""
    rng, n = np.random.default_rng(seed), round(seconds / STEP_S)
    t, table = np.arange(n) * STEP_S, np.zeros((n, len(NAMES)))
    gust, v, p = 0.0, 0.0, 0.0
    column = {name: table[:, k] for k, name in enumerate(NAMES)}
    for k in range(n):
        gust = 0.9 * gust + np.sqrt(1 - 0.9**2) * GUST_M_S2 * rng.standard_normal()
        pushed = gust - 0.8 * v - 0.3 * p
        v, p = v + STEP_S * pushed, p + STEP_S * v
        north, yaw = pushed + 1.0, 0.2 * t[k]  # a steady wind that the vehicle turns in
        column["f_x_m_s2"][k], column["f_y_m_s2"][k] = north * np.cos(yaw), -north * np.sin(yaw)
        column["v_x_m_s"][k], column["yaw_rad"][k] = v + 1.0 * t[k], yaw
    column["r_rad_s"] += 0.2
    column["yaw_rate_ref_rad_s"] += 0.2
    column["roll_ref_rad"] -= 0.05
    column["throttle"][:] = 0.4 + 0.02 * np.sign(np.sin(t))
    for name, std in (
        ("roll_rad", 0.003),
        ("pitch_rad", 0.003),
        ("r_rad_s", 0.01),
        ("p_rad_s", 0.02),
        ("f_z_m_s2", 0.1),
    ):
        column[name] += std * rng.standard_normal(n)
    column["f_z_m_s2"] += G_M_S2 * column["throttle"] / 0.4
    column["v_z_m_s"] += np.cumsum(column["f_z_m_s2"] - G_M_S2) * STEP_S
    return np.column_stack([t, table])


@pytest.fixture(scope="module")
def listed(tmp_path_factory):
    """A list of a windy set and of one without angles, and the folder of both."""
    tmp_path = tmp_path_factory.mktemp("listed")
    (tmp_path / "map.yaml").write_text(COLUMNS + "".join(f"  {name}: {name}\n" for name in ("t_s", *NAMES)))
    (tmp_path / "few.yaml").write_text(COLUMNS + "".join(f"  {name}: {name}\n" for name in ("t_s", *NAMES[3:])))
    np.savetxt(tmp_path / "windy.csv", windy(), delimiter=",", header=",".join(("t_s", *NAMES)), comments="")
    (tmp_path / "list.yaml").write_text(
        "format: recordings/1\nsets:\n"
        "  - {name: windy hover, source: somebody, files: [windy.csv], columns: map.yaml}\n"
        "  - {name: no angles, source: another, files: [windy.csv], columns: few.yaml}\n"
    )
    return tmp_path / "list.yaml", tmp_path


@pytest.fixture(scope="module")
def windy_blocks(listed):
    """Of the windy set."""
    return transplanted_noise.blocks_of(
        NoiseSource("windy hover", ("windy.csv",), str(listed[1] / "map.yaml"), str(listed[1]))
    )


def quiet(seconds=40.0, tilt_rad=0.0):
    """A hover without noise."""
    t = np.arange(0.0, seconds, 0.01)
    flat = np.zeros(t.size)
    columns = {
        "attitude": {"roll_rad": flat, "pitch_rad": flat + tilt_rad, "yaw_rad": flat},
        "rates": {"p_rad_s": flat, "q_rad_s": flat, "r_rad_s": flat},
        "specific_force": {"f_x_m_s2": flat, "f_y_m_s2": flat, "f_z_m_s2": flat + G_M_S2},
        "velocity": {"v_x_m_s": flat, "v_y_m_s": flat, "v_z_m_s": flat},
        "height": {"height_m": flat + 5.0},
    }
    return Recording("hover", {g: Series(t, c) for g, c in columns.items()}, (), Provenance("a test", "table"))


def test_every_case_that_is_drawn_of_a_seed_and_its_seal_stay_what_they_were():
    cases = [draw(20261513, k) for k in range(3)]
    assert [c.sha256()[:16] for c in cases] == SEALED
    assert "noise_from" not in cases[0].truth()


# Of benchmarks/seals/proof_20261513.csv, drawn before there was real noise.
SEALED = ["3d30d0e05b65ca84", "b40c2875cafdf1cf", "da2eaa0423ce2799"]


def test_half_the_cases_have_real_noise_and_are_otherwise_the_same(listed):
    plain = cases_of(5, 200)
    cases = transplanted_noise.with_real_noise(plain, read_sets(listed[0]), listed[1])
    real = [c for c in cases if c.noise_from is not None]
    assert 80 <= len(real) <= 120
    assert {c.noise_from.name for c in real} == {"windy hover"}, "what has no angles gives no noise"
    assert all((c.noise, c.gust_rms_m_s) == (0.0, 0.0) for c in real)
    for before, case in zip(plain, cases, strict=True):
        conditions = {"noise": before.noise, "gust_rms_m_s": before.gust_rms_m_s, "noise_from": None}
        assert replace(case, **conditions) == before
        assert (case == before) == (case.noise_from is None)
    truth = json.loads(real[0].truth())
    assert truth["noise_from"] == {"name": "windy hover", "files": ["windy.csv"]}
    assert str(listed[1]) not in real[0].truth()
    some = transplanted_noise.with_real_noise(plain[:7], read_sets(listed[0]), listed[1])
    assert some == cases[:7]


def test_recordings_that_cannot_give_noise_are_refused_with_what_they_lack(listed):
    sets = [one for one in read_sets(listed[0]) if one.name == "no angles"]
    with pytest.raises(InputError, match="has angles"):
        transplanted_noise.with_real_noise(cases_of(5, 2), sets, listed[1])
    with pytest.raises(InputError, match="needs recordings and their folder"):
        run_trials(ProofRequest(1, 1, recordings=listed[0]))
    with pytest.raises(InputError, match="'sitl' takes no recordings"):
        run_trials(ProofRequest(1, 1, "sitl", recordings=listed[0], data=listed[1]))


@pytest.mark.slow
def test_a_flight_gets_the_gusts_of_the_recording_and_their_velocity(windy_blocks, monkeypatch):
    blocks = windy_blocks
    assert len(blocks) > 15
    every = np.concatenate(blocks)
    assert np.hypot(*np.std(every[:, :2], axis=0)) == pytest.approx(GUST_M_S2, rel=0.15), "no steady wind is in it"
    assert np.std(every[:, 3]) < 0.01, "velocity is the integral of force"
    assert np.allclose(
        np.average([b.mean(axis=0) for b in blocks], axis=0, weights=[len(b) for b in blocks]), 0.0, atol=3e-3
    )
    step = SimpleNamespace(usable=True, kind="roll_step", t_s=np.array([0.5, 39.0]))
    monkeypatch.setattr(transplanted_noise, "cut", lambda _flown: (step,))
    noise = transplanted_noise.RealNoise(blocks, (0.0, 0.0, 0.0), 1)
    flown, other = noise.on(quiet()), replace(noise, seed=2).on(quiet())
    force = flown.channel("f_x_m_s2")[1]
    assert np.std(force) == pytest.approx(GUST_M_S2 / np.sqrt(2.0), rel=0.25)
    t, velocity = flown.channel("v_x_m_s")
    moved = np.interp(t[5:], *flown.channel("f_x_m_s2"))
    assert np.corrcoef(np.gradient(velocity[5:], t[5:]), moved)[0, 1] > 0.9, "force and velocity belong together"
    assert np.std(flown.channel("f_z_m_s2")[1]) == pytest.approx(0.1, rel=0.4)
    assert abs(np.corrcoef(force, other.channel("f_x_m_s2")[1])[0, 1]) < 0.2, "another order"
    assert np.std(flown.channel("roll_rad")[1]) == pytest.approx(0.003, rel=0.3)


def one_block(columns, seconds=3.0):
    block = np.zeros((round(seconds / STEP_S), 11))
    for k, value in columns.items():
        block[:, k] = value
    return block


def test_where_blocks_overlap_their_variance_is_kept_and_force_is_the_slope_of_velocity():
    rng = np.random.default_rng(0)
    white = [one_block({0: rng.standard_normal(150)}) for _ in range(200)]
    total = transplanted_noise.joined_blocks(white, 40_000, np.random.default_rng(1))[:, 0]
    assert np.std(total) == pytest.approx(1.0, abs=0.02)
    fast = transplanted_noise.RealNoise(tuple(white), (0.0, 0.0, 0.0), 1).on(quiet(200.0)).channel("f_x_m_s2")[1]
    assert np.std(fast) == pytest.approx(1.0, abs=0.05), "at twice the rate of the blocks, too"
    waves = [one_block({3: np.sin(w * np.arange(150) * STEP_S)}) for w in (1.0, 1.7, 2.3)]
    joined = transplanted_noise.joined_blocks(waves, 4000, np.random.default_rng(1))[:, 3]
    assert np.max(np.abs(np.diff(joined))) < 0.15, "no jumps"
    assert np.max(np.abs(np.diff(joined, 2))) < 0.02, "no kinks"


def test_a_force_pushes_along_the_body_and_moves_the_vehicle(monkeypatch):
    step = SimpleNamespace(usable=True, kind="roll_step", t_s=np.array([0.5, 39.0]))
    monkeypatch.setattr(transplanted_noise, "cut", lambda _flown: (step,))
    t = np.arange(3000) * STEP_S
    gust = transplanted_noise.RealNoise((one_block({2: np.sin(5.0 * t)}, 60.0),), (0.0, 0.0, 0.0), 1)
    flown = gust.on(quiet(tilt_rad=0.3))
    assert np.std(flown.channel("f_x_m_s2")[1]) < 1e-9
    assert np.std(flown.channel("f_z_m_s2")[1]) == pytest.approx(np.sqrt(0.5), rel=0.02)
    at, v = flown.channel("v_x_m_s")
    assert np.std(np.gradient(v, at)) == pytest.approx(np.sin(0.3) * np.sqrt(0.5), rel=0.05)


def test_a_vehicle_that_the_air_tilts_is_pushed_by_its_thrust_and_answers_only_between_steps(monkeypatch):
    tilted = transplanted_noise.RealNoise((one_block({7: 0.01}, 60.0),), (0.0, 0.0, 0.0), 1)
    step = SimpleNamespace(usable=True, kind="roll_step", t_s=np.array([10.5, 12.0]))
    monkeypatch.setattr(transplanted_noise, "cut", lambda _flown: (step,))
    flown = tilted.on(quiet())
    t, v = flown.channel("v_x_m_s")
    before, end = np.interp([10.0, 12.0], t, v)
    assert end - before == pytest.approx(G_M_S2 * 0.01 * 2.0, rel=0.02)
    assert before == pytest.approx(G_M_S2 * 0.01 / transplanted_noise.ANSWER_1_S, rel=0.05)
    assert np.interp(15.0, t, v) == pytest.approx(before, rel=0.05)
    slowed = replace(tilted, drag_1_s=(1.0, 1.0, 1.0)).on(quiet())
    assert np.interp(12.0, *slowed.channel("v_x_m_s")) < 0.85 * end
    assert np.interp(12.0, *slowed.channel("f_x_m_s2")) == pytest.approx(
        -np.interp(12.0, *slowed.channel("v_x_m_s")), rel=0.05
    )


@pytest.mark.slow
def test_what_hits_the_ground_is_no_noise(listed):
    crashed = windy()
    crashed[-100:, 1 + NAMES.index("f_z_m_s2")] += 20.0 * np.sign(np.sin(40.0 * crashed[-100:, 0]))
    np.savetxt(listed[1] / "crash.csv", crashed, delimiter=",", header=",".join(("t_s", *NAMES)), comments="")
    blocks = transplanted_noise.blocks_of(
        NoiseSource("crash", ("crash.csv",), str(listed[1] / "map.yaml"), str(listed[1]))
    )
    assert max(float(np.abs(b[:, 2]).max()) for b in blocks) < 2.0


@pytest.mark.slow
def test_a_trial_flies_quietly_and_is_diagnosed_with_the_noise_of_its_source(listed, windy_blocks, monkeypatch):
    (case,) = [
        c for c in transplanted_noise.with_real_noise(cases_of(5, 8), read_sets(listed[0]), listed[1]) if c.noise_from
    ][:1]
    asked, sources = [], []

    def blocks_of(source):
        sources.append(source)
        return windy_blocks

    def flown(options, folder, generator, script, changed):
        asked.append(options)
        return (SimpleNamespace(kind="roll_step", usable=True, flown=changed(quiet())),)

    monkeypatch.setattr(trial, "fly_campaign", flown)
    monkeypatch.setattr(trial, "blocks_of", blocks_of)
    (noisy,), (twin,) = trial.flown_segments(case), trial.flown_segments(case, quiet=True)
    assert [(o.noise, o.gust_rms_m_s) for o in asked] == [(0.0, 0.0)] * 2
    assert np.std(noisy.flown.channel("f_x_m_s2")[1]) > 0.5 * GUST_M_S2
    assert np.std(twin.flown.channel("f_x_m_s2")[1]) == 0.0
    assert sources == [case.noise_from]


def test_the_scoreboard_counts_real_noise_apart(tmp_path, listed, monkeypatch):
    def answer(case):
        named = ("steady_wind",) if case.noise_from is not None else tuple(case.hide)
        sizes = dict.fromkeys(case.hide, 5.0)
        return Outcome(case.index, case.kind, case.sha256(), case.hide, named, sizes=sizes, truth=case.truth())

    monkeypatch.setattr("flighttest.proof.trial.run_trial", answer)
    result = proving.prove(ProofRequest(40, 5, recordings=listed[0], data=listed[1]), output=tmp_path / "proof")
    real, synthetic = result.data["score"]["by_noise"]
    assert (real["noise"], synthetic["noise"]) == ("of real recordings", "synthetic")
    assert real["trials"] + synthetic["trials"] == 40
    assert real["false_alarms"][0] == real["false_alarms"][1] > 0
    assert synthetic["false_alarms"][0] == 0
    assert synthetic["first"][0] == synthetic["first"][1] > 0 == real["first"][0]
    text = (tmp_path / "proof" / "proof.md").read_text()
    assert f"- false alarms, noise and gusts of real recordings ({real['trials']} trials): " in text
    assert f"- right class first, noise and gusts synthetic ({synthetic['trials']} trials): " in text
    plain = [replace(o, truth="") for o in result.value]
    assert score(plain)["by_noise"] == []
    assert "real recordings" not in markdown(plain, 5)


@pytest.mark.slow
def test_public_recordings_give_blocks_of_their_own_noise(repository, shared_data):
    sets = read_sets(repository / "examples" / "recordings" / "public.yaml")
    cases = transplanted_noise.with_real_noise(cases_of(1, 300), sets, shared_data)
    names = {c.noise_from.name.split(",")[0] for c in cases if c.noise_from is not None}
    assert names == {"wind tunnel", "ArduCopter", "ArduCopter SITL", "real firmware"}
    source = next(
        c.noise_from for c in cases if c.noise_from is not None and c.noise_from.name == "wind tunnel, 8.5 m/s"
    )
    windy, still = (
        transplanted_noise.blocks_of(s)
        for s in (
            source,
            next(c.noise_from for c in cases if c.noise_from and c.noise_from.name == "wind tunnel, still air"),
        )
    )
    for blocks in (windy, still):
        assert all(len(b) * STEP_S >= transplanted_noise.LEAST_S for b in blocks)
    assert np.std(np.concatenate(windy)[:, 7]) > 2.0 * np.std(np.concatenate(still)[:, 7]), "wind along x tilts"
