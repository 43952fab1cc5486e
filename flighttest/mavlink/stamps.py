"""When a message was made: from the vehicle's time stamps, with what rounding took from them, and from the ground's where there is none."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.mavlink.clock import ClockEstimate
from flighttest.mavlink.telemetry import RULES, STAMP_SCALE, Rule

FloatArray = NDArray[np.float64]

HALF_MS = 0.5e-3  # what rounding down to a whole ms takes on average
_WHOLE_MS_S = 2e-6  # times this near to whole ms all along come from a clock that steps in whole ms
_LATE_S = 0.05  # a firmware's serial port is served every 10 ms of its own time, and the ground looks at it every 20 ms
_BESIDE_S = 0.5  # a message without a stamp goes by the stamp of one that came this short before it


def stamped_rules(raw: Collection[str]) -> list[Rule]:
    """The rules of messages that came and carry the vehicle's time, one a message."""
    seen = {rule.message: rule for rule in RULES if rule.stamp and rule.message in raw}
    return list(seen.values())


def stamps(rule: Rule, raw: Mapping[str, FloatArray], lost_s: float) -> FloatArray:
    """The vehicle's time stamps, s, of a rule that has them; lost_s: what rounding to ms took from them, put back."""
    assert rule.stamp is not None
    return raw[rule.stamp] * STAMP_SCALE[rule.stamp] + (lost_s if rule.stamp == "time_boot_ms" else 0.0)


def rounded_off(raw: Mapping[str, Mapping[str, FloatArray]]) -> float:
    """What rounding time_boot_ms down takes from the vehicle's time on average, s.

    By its microsecond stamps where there are any; without them half a ms, unless all stamps lie on a coarser grid (a simulator's).
    """
    fine = [raw[r.message]["time_usec"] for r in stamped_rules(raw) if r.stamp == "time_usec"]
    if fine:
        return float(np.mean(np.concatenate(fine) % 1e3)) * 1e-6
    coarse = [np.diff(raw[r.message]["time_boot_ms"]).astype(np.int64) for r in stamped_rules(raw)]
    return HALF_MS if not coarse or int(np.gcd.reduce(np.concatenate(coarse))) <= 1 else 0.0


def times_of(
    raw: Mapping[str, Mapping[str, FloatArray]],
    ground: Mapping[str, FloatArray],
    order: Mapping[str, NDArray[np.int64]],
    clock: ClockEstimate,
    lost_s: float,
) -> dict[str, FloatArray]:
    """When the vehicle made each message, s, by message name.

    A message without a stamp passed the same link as the stamped one before it: it was made as much later as it came, whatever the link's
    delay. By the ground's clock alone it would be late by that delay.
    """
    rules = {r.message: r for r in stamped_rules(raw)}
    found = {kind: stamps(rule, raw[kind], lost_s) for kind, rule in rules.items()}
    if not found:
        return {kind: clock.to_vehicle(ground[kind]) for kind in raw}
    at = np.concatenate([order[k] for k in found])
    rank = np.argsort(at, kind="stable")
    at = at[rank]
    g, v = (np.concatenate([x[k] for k in found])[rank] for x in (ground, found))
    for kind in raw:
        if kind in found:
            continue
        before = np.maximum(np.searchsorted(at, order[kind]) - 1, 0)
        since = ground[kind] - g[before]
        beside = (at[before] < order[kind]) & (since >= 0.0) & (since < _BESIDE_S)
        found[kind] = np.where(beside, v[before] + since * clock.rate, clock.to_vehicle(ground[kind]))
    return found


def in_lock_step(
    sent_s: FloatArray, stamp_s: FloatArray, arrived_s: FloatArray, made_s: FloatArray
) -> tuple[float, float] | None:
    """One moment as (ground time, vehicle time), s, where a sender and a simulated vehicle step through time together; else None.

    sent_s, stamp_s: (n,) when targets were sent, and what they are stamped; arrived_s, made_s: (m,) when the vehicle's messages came, and
    what they are stamped. Both step in whole ms then, and nothing comes much later than it was made.
    """
    within = np.abs((sent_s - sent_s[0] + HALF_MS) % 1e-3 - HALF_MS)
    ahead = sent_s - stamp_s
    if np.max(within) > _WHOLE_MS_S or np.ptp(ahead) > 1e-3 + _WHOLE_MS_S:
        return None
    during = (arrived_s >= sent_s.min()) & (arrived_s <= sent_s.max())
    late = arrived_s[during] - made_s[during] - np.min(ahead)
    if not late.size or np.max(late) > _LATE_S:
        return None
    first = int(np.argmin(ahead))
    return float(sent_s[first]), float(stamp_s[first])
