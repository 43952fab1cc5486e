"""The campaigns on this machine, and which one's model stands."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flighttest.errors import FlighttestError, InputError
from flighttest.estimation.uncertainty.distributions import quantile
from flighttest.identify.models import model_file
from flighttest.identify.models.model_file import ModelFile, StoredParameter
from flighttest.pipeline.store.identities import known_in, of_manifest, recognised, run_folders
from flighttest.recording.store import MANIFEST_NAME, read_manifest
from flighttest.validity.compare import KNOWN_STD, MANY, Estimates
from flighttest.validity.declared import declared_changes
from flighttest.validity.model import SUBSETS

FIT_NAME = "fit.yaml"
DEFAULT_RUNS = Path("runs")  # where runs go unless stated otherwise; not there before the first
TOGETHER = ("K", "alpha")  # may determine together what a throttle gives where neither is known alone
# Where a delay hangs at its bound, the loop behind it takes up what the delay cannot: it is not determined.
LAGS: dict[str, tuple[str, ...]] = {
    "T_d_attitude": SUBSETS["attitude"],
    "T_d_yaw_rate": SUBSETS["yaw"],
    "T_d_thrust": ("sigma_t",),
}
TESTED = tuple(n for names in SUBSETS.values() for n in names)


def folder_of_runs(sources: Iterable[object]) -> Path:
    """The folder that holds the first run among some sources; where none is a run, the usual one."""
    run = next((s for s in sources if isinstance(s, Path) and (s / MANIFEST_NAME).is_file()), None)
    if run is None:
        return DEFAULT_RUNS
    return (run if run.name not in ("", "..") else run.resolve()).parent


@dataclass(frozen=True)
class StoredFit:
    """One joint fit found in a folder of runs. runs: the recordings it was fitted to."""

    folder: Path
    model: ModelFile

    @property
    def estimates(self) -> Estimates:
        """The watched, identified part."""
        return watched(self.model, self.folder.name)

    def follows(self, stored: ModelFile) -> bool:
        """Whether this campaign came after a model's own, has its terms (others move the parameters), and nothing declared has changed."""
        if self.model.model.terms != stored.model.terms:
            return False
        if not self.model.runs or set(map(str, self.model.runs)) & set(map(str, stored.runs)):
            return False
        last = max((str(r) for r in stored.runs), default="")
        changes, _ = declared_changes(stored.fingerprint, self.model.fingerprint)
        return str(self.model.runs[-1]) > last and not changes


def watched(model: ModelFile, name: str, tested: Sequence[str] = TESTED) -> Estimates:
    """The identified ones of the parameters that are tested, with their covariance.

    The scatter of few responses is itself badly known: the degrees of freedom are those of the 95 % intervals (Student's factor).
    """
    lost = {n for delay, lags in LAGS.items() if _at_bound(model.parameters.get(delay)) for n in lags}
    names = tuple(
        n
        for n in model.order
        if n in tested
        and n in model.parameters
        and n not in lost
        and (n in TOGETHER or _determines(model.parameters[n]))
    )
    values = np.array([model.parameters[n].value for n in names])
    pick = np.array([model.order.index(n) for n in names], dtype=np.intp)
    matrix = model.covariance[np.ix_(pick, pick)]
    dof = np.full(len(names), MANY)
    for i, n in enumerate(names):
        stored, scatter = model.parameters[n], float(matrix[i, i]) ** 0.5
        if stored.interval_95 is None:
            dof[i] = 1.0
        elif stored.std and scatter > 0.0:
            # Of the interval, which holds more than the scatter (`Covariance.of`).
            whole = dof_of((stored.interval_95[1] - stored.interval_95[0]) / (2.0 * stored.std))
            dof[i] = max(1.0, whole * min(scatter / stored.std, 1.0) ** 4)
    volts, nominal = model.valid.get("voltage_v"), model.model.nominal_voltage_v
    there = math.log(float(np.mean(volts)) / nominal) if volts else math.nan
    weak = frozenset(n for n in names if n in TOGETHER and not model.parameters[n].identifiable)
    return Estimates(name, names, values, matrix, dof, there, weak)


def _at_bound(delay: StoredParameter | None) -> bool:
    return delay is not None and delay.source == "fit" and delay.std is None


def _determines(p: StoredParameter) -> bool:
    """Whether a parameter can be compared: also one from too few responses for a standard error, as in a spot check, if it
    came out sharply: what campaigns differ by is allowed for anyway."""
    return p.identifiable or (p.std is not None and p.std < KNOWN_STD * abs(p.value))


def dof_of(factor: float) -> float:
    """Degrees of freedom at which Student's two-sided 95 % quantile is `factor`."""
    from scipy.optimize import brentq

    if factor <= quantile(0.975, MANY):
        return MANY
    if factor >= quantile(0.975, 1.0):
        return 1.0
    return float(brentq(lambda nu: quantile(0.975, nu) - factor, 1.0, MANY))


def campaigns(folder: Path, vehicle: str) -> list[StoredFit]:
    """Distinct fits of one vehicle's runs in a folder, with the terms that a diagnosis found, oldest first; files that cannot be read are
    passed over (`runs` names them)."""
    found: dict[tuple[str, ...], StoredFit] = {}
    known = known_in(folder)
    for run in run_folders(folder):
        path = run / FIT_NAME
        if not path.is_file():
            continue
        try:
            if recognised(of_manifest(read_manifest(run)), known) != vehicle:
                continue
            stored = model_file.read(model_file.held_by(run))
        except FlighttestError:
            continue  # an old or broken file must not hide the others
        found[tuple(str(r) for r in stored.runs) or (run.name,)] = StoredFit(run, stored)
    return list(found.values())


# A new model takes the place of an old one when it determines as much: each of the watched parameters at most so many times as badly.
AS_GOOD = 2.0


def as_good(new: ModelFile, old: ModelFile) -> bool:
    """Whether a model determines all that another one does, and hardly worse: a spot check does not replace a campaign."""
    mine, theirs = _known(new), _known(old)
    return all(name in mine and mine[name] <= AS_GOOD * std for name, std in theirs.items())


def _known(model: ModelFile) -> dict[str, float]:
    sure = {n: p.std for n, p in model.parameters.items() if n in TESTED and p.identifiable}
    return {n: std for n, std in sure.items() if std is not None}


def reference_model(known: Sequence[StoredFit]) -> StoredFit | None:
    """The campaign whose model is in use: the last one that is as good as the one before it, or flown after a declared change."""
    kept: StoredFit | None = None
    for campaign in known:
        if kept is not None and not as_good(campaign.model, kept.model):
            changes, _ = declared_changes(kept.model.fingerprint, campaign.model.fingerprint)
            if not (changes and set(_known(campaign.model)) >= set(_known(kept.model))):
                continue
        kept = campaign
    return kept


def vehicle_name(run: Path) -> str:
    """The name of the vehicle a run was flown with; empty where it is not known."""
    try:
        return of_manifest(read_manifest(run)).name
    except FlighttestError:
        return ""


def check_runs(folder: Path) -> None:
    """InputError where a folder of runs that was named is none; the usual one need not be there yet."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is not a folder", "name the folder that holds the runs")
    if not folder.exists() and folder != DEFAULT_RUNS:
        raise InputError(
            f"{folder}: there is no such folder", "name the folder that holds the runs, as `run --out` had it"
        )


def when(name: str) -> str:
    """The date and time a run folder's name begins with; empty where it begins otherwise."""
    found = re.match(r"(\d{4}-\d\d-\d\d)T(\d\d)-(\d\d)-(\d\d)", name)
    return f"{found[1]} {found[2]}:{found[3]}:{found[4]}" if found else ""
