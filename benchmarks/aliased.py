"""Which effects leave the same behind? `python -m benchmarks.aliased --cache DIR` flies one vehicle of the proof with each effect of usual
size, without noise and gusts (a quarter of a minute each, kept in DIR), and prints what `flighttest/proof/cases.py` holds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.frozen import fly_to, responses
from flighttest.errors import FlighttestError
from flighttest.proof import oracle
from flighttest.proof.cases import NOT_HIDDEN
from flighttest.segments import Segment
from flighttest.sim import SimOptions
from flighttest.sim.plants.rotor_effects import EFFECTS
from flighttest.sim.plants.rotor_vehicle import random_rotor

VEHICLE = 1


def flight(cache: Path, name: str) -> list[Segment]:
    """Of one effect, 'nothing' or 'noisy' (nothing, with noise); flown where it is not there."""
    run = cache / name
    if not run.exists():
        hide: dict[str, dict[str, float]] = {} if name in ("nothing", "noisy") else {name: {}}
        noise = 1.0 if name == "noisy" else 0.0
        fly_to(run, SimOptions(airframe="rotor", hide=hide, seed=VEHICLE, vehicle_seed=VEHICLE, noise=noise))
    return responses(run)[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cache", type=Path, required=True)
    cache = parser.parse_args().cache
    cache.mkdir(parents=True, exist_ok=True)
    voltage = random_rotor(VEHICLE).nominal_voltage_v
    quiet = flight(cache, "nothing")
    noise = oracle.oracle_noise(flight(cache, "noisy"), quiet, voltage)
    usual = oracle.left(quiet, noise, voltage)
    effects = {}
    for name in (k for k, e in EFFECTS.items() if e.known and k not in NOT_HIDDEN):
        try:
            effects[name] = oracle.left(flight(cache, name), noise, voltage).less(usual)
        except FlighttestError as error:
            print(f"# {name}: {error.message}")
            continue
        print(f"# {name}: {oracle.size_in_floors(effects[name], noise):.2f} noise floors")
    for name, effect in effects.items():
        near = sorted(
            ((oracle.cosine(effect, other, noise), o) for o, other in effects.items() if o != name), reverse=True
        )
        print(f"# {name}: {', '.join(f'{o} {c:.3f}' for c, o in near[:3])}")
        alike = sorted({name, *(o for c, o in near if c > oracle.CONFUSABLE)})
        if len(alike) > 1:
            print(f'    "{name}": {tuple(alike)!r},')


if __name__ == "__main__":
    main()
