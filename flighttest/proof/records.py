"""What a scoreboard counts, as proof.json carries it, with known keys. A count is (of how many it holds, how many there are)."""

from __future__ import annotations

from typing import TypedDict

Counted = tuple[int, int]


class NotFlown(TypedDict):
    """A trial that did not fly, and why."""

    index: int
    why: str


class NameRates(TypedDict):
    """How often what was hidden was named, and what was not hidden was."""

    first: Counted
    absorbed: Counted
    false_alarms: Counted
    nothing_hidden: int
    pairs: Counted
    outside_misnamed: Counted
    outside_located: Counted
    extra_names: Counted
    changes: Counted
    unchanged: Counted
    wind_changes: Counted
    wind_unchanged: Counted


class NoiseRow(TypedDict):
    """Trials whose noise and disturbance are of one origin: how many flew, how often what was hidden was named first, and what was not
    hidden was named."""

    noise: str
    trials: int
    first: Counted
    false_alarms: Counted


class Magnitudes(TypedDict):
    """Relative errors of forces and of parameters of what was named, share of the error that is gone, time of a diagnosis, s: medians."""

    force_ratio_median_error: float | None
    force_ratios: int
    value_median_error: float | None
    values: int
    gain_median: float | None
    cpu_median_s: float | None
    wall_median_s: float | None


ReliabilityRow = TypedDict("ReliabilityRow", {"from": float, "to": float, "stated": float | None, "right": Counted})
ReliabilityRow.__doc__ = "Names whose stated probability lies between two: its mean, and how many are right."


class Calibration(TypedDict):
    """How often intervals hold the truth and how wide they are; how often names are right beside the probability stated."""

    values_inside: Counted
    base_inside: Counted
    value_median_width: float | None
    inside_by_parameter: dict[str, Counted]
    reliability: list[ReliabilityRow]
    brier: float | None
    coverage_mean: float | None
    coverage_within: Counted


PowerRow = TypedDict("PowerRow", {"from": float, "to": float, "n": int, "named": int})
PowerRow.__doc__ = "Effects of a size between two, noise floors, and how many of them were named."


class ConfusionRow(TypedDict):
    """What was hidden and what was named first, in how many trials."""

    hidden: str
    named: str
    count: int


Miss = TypedDict("Miss", {"index": int, "hidden": str, "size": float, "why": str, "class": list[str]})
Miss.__doc__ = "A trial in which something hidden was not named, or something else was; class: what cannot be distinguished from it."


class Scores(NameRates, Magnitudes, Calibration):
    """Every number of the scoreboard."""

    trials: int
    flown: int
    not_flown: list[NotFlown]
    by_noise: list[NoiseRow]
    power: list[PowerRow]
    confusion: list[ConfusionRow]
    misses: list[Miss]
