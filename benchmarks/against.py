"""Sealed pairs of simulators: `python -m benchmarks.against --pairs 20 --seed 1`.

Of each pair one side plays reality. A third differ in nothing but noise and gusts, a third in one parameter by 10 % (a delay by 20 ms), a
third in an effect of the catalogue at its usual size. Drawn by seed from the built-in rotor vehicle, whose equations are not those of the
catalogue; the comparison is made before the truth is read. Printed: what was changed, what was found, and the counts.

right: the parameter, or a parameter of the effect, differs; in a pair without a change nothing does. noted: something else differs, and the
notes name the effect as one that it may stand for. small: nothing differs, and the change is below the smallest that the comparison said
would show. noticed: something else differs. missed: nothing does. FALSE: something differs where nothing was changed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from flighttest.diagnose import diagnose
from flighttest.diagnose.against import compare_sides
from flighttest.errors import FlighttestError
from flighttest.frames import G_M_S2
from flighttest.physics.model import Model
from flighttest.proof.cases import draw
from flighttest.proof.flying import case_options, fly_campaign
from flighttest.sim.plants.rotor_vehicle import random_rotor

# Constant of the rotor vehicle to the parameters of the model that it is.
CONSTANTS = {
    "hover_throttle": ("K",), "drag_z_1_s": ("d_z",), "drag_x_1_s": ("d_x",), "ramp_1_s": ("sigma_t",), "omega_roll": ("omega_phi",),
    "zeta_pitch": ("zeta_theta",), "sigma_r_1_s": ("sigma_r",), "delay_s": ("T_d_attitude", "T_d_yaw_rate", "T_d_thrust"),
}  # fmt: skip


def pair(seed: int, index: int) -> str:
    """Fly, diagnose and compare one pair; a line with what was changed and what was found."""
    rng = np.random.default_rng([seed, index])
    kind = ("clean", "parameter", "effect")[index % 3]
    case = draw(seed, index, "rotor")
    effect = next(c for k in range(200) if (c := draw(seed, 1000 * (index + 1) + k)).kind == "single")
    base = replace(case_options(replace(case, hide={})), vehicle_seed=case.vehicle_seed)
    real, truth, expected, change = replace(base, seed=base.seed + 1), "nothing", (), np.inf
    if kind == "parameter":
        name = str(rng.choice(list(CONSTANTS)))
        value = float(getattr(random_rotor(case.vehicle_seed), name))
        changed = value + 0.02 if name == "delay_s" else value * float(rng.choice([0.9, 1.1]))
        real, truth, expected = (
            replace(real, vehicle={name: changed}),
            f"{name} {value:.3g} to {changed:.3g}",
            CONSTANTS[name],
        )
        change = G_M_S2 / changed - G_M_S2 / value if name == "hover_throttle" else changed - value
    elif kind == "effect":
        real, truth = replace(real, hide={k: dict(v) for k, v in effect.hide.items()}), str(dict(effect.hide))
        expected = tuple(effect.hide)
    with tempfile.TemporaryDirectory() as scratch:
        sides = [fly_campaign(o, Path(scratch) / n) for o, n in ((real, "real"), (base, "simulated"))]
    model = Model(nominal_voltage_v=random_rotor(case.vehicle_seed).nominal_voltage_v)
    found = compare_sides(sides[0], sides[1], *(diagnose(s, model) for s in sides))
    names = {d.name for d in found.differing} | {
        d.term for d in found.differing if d.term not in ("body", "linear_drag")
    }
    right = bool(names & set(expected)) if expected else not names
    small = [d for d in found.differences if d.name in expected and d.detectable and abs(change) < d.detectable]
    noted = names and any(f"{n} " in note for n in expected for note in found.notes)
    other = ("noticed" if names else "missed") if expected else "FALSE"
    word = "right" if right else "noted" if noted else "small" if small and not names else other
    said = ", ".join(f"{d.name} {d.kind}" for d in found.differing) or "no difference"
    nearest = min((d.p_value for d in found.differences if d.p_value is not None), default=1.0)
    return f"{index:3d} {kind:9s} {word:8s} {truth}: {said}; smallest p {nearest:.1e}"


def main() -> None:
    """Every pair, then the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first pair, to go on with a run")
    options = parser.parse_args()
    lines = []
    for index in range(options.first, options.first + options.pairs):
        began = time.monotonic()
        try:
            lines.append(pair(options.seed, index))
        except FlighttestError as error:
            lines.append(f"{index:3d} not flown: {error}")
        print(f"{lines[-1]} ({time.monotonic() - began:.0f} s)", flush=True)
    for kind in ("clean", "parameter", "effect"):
        words = [line.split()[2] for line in lines if line.split()[1] == kind]
        counted = ", ".join(f"{words.count(w)} {w}" for w in dict.fromkeys(words))
        print(f"{kind}: {len(words)} pairs, {counted or 'none'}")


if __name__ == "__main__":
    main()
