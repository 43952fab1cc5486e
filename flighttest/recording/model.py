"""`Recording`: groups of channels, each on its own time base, with the marks of the flight and where it all came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flighttest.channels import CHANNELS
from flighttest.errors import RecordingError
from flighttest.recording.manifest import ClockData, Components, EventData, VehicleData

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

FloatArray = NDArray[np.float64]


LARGEST = 1e100  # of a value in any unit: sums of squares of greater ones overflow a float64, and nothing measures them


def _measured(values: Any) -> FloatArray:
    array = np.asarray(values, dtype=float)
    return np.where(np.abs(array) <= LARGEST, array, np.nan)


def _frozen(values: Any) -> FloatArray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Series:
    """Channels sampled together.

    t_s: (n,) s on the vehicle's clock, strictly increasing. columns: channel name to (n,) values in the unit of
    `channels.CHANNELS`; NaN marks a sample that is missing, as does one beyond `LARGEST`. Both are read-only.
    """

    t_s: FloatArray
    columns: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", _frozen(self.t_s))
        object.__setattr__(self, "columns", {name: _frozen(_measured(v)) for name, v in self.columns.items()})
        for name, values in self.columns.items():
            if name not in CHANNELS:
                raise RecordingError(f"unknown channel {name!r}", "see the channel table in docs/formats.md")
            if values.shape != self.t_s.shape:
                raise RecordingError(f"channel {name} has {values.size} samples, its time base {self.t_s.size}")
        if not bool(np.all(np.isfinite(self.t_s))) or bool(np.any(np.diff(self.t_s) <= 0)):
            raise RecordingError("time does not increase", "sort the samples and drop repeated time stamps first")

    def __len__(self) -> int:
        return int(self.t_s.size)

    def __repr__(self) -> str:
        return f"<Series: {len(self)} samples at {self.rate_hz:.0f} Hz of {', '.join(self.columns)}>"

    @cached_property  # of each series asked for with each segment: an hour has a thousand
    def rate_hz(self) -> float:
        """Median sample rate, Hz; 0 for fewer than two samples."""
        return float(1.0 / np.median(np.diff(self.t_s))) if self.t_s.size > 1 else 0.0


@dataclass(frozen=True)
class Marker:
    """A mark on the vehicle's clock. kind: leg, phase, abort, take_over, link_lost, mode, note."""

    t_s: float
    kind: str
    label: str
    data: EventData = field(default_factory=EventData)


@dataclass(frozen=True)
class Provenance:
    """Where a recording came from, and what was lost on the way.

    source: path or URL; importer: ardupilot_bin, tlog, ulg, table, flight; sha256 of the raw file; firmware: full version
    string; parameters: every vehicle parameter that is known; components: as declared in vehicle.yaml;
    clock: offset_s, error_s and method of the ground-to-vehicle clock; losses: sentences, each naming what and where;
    filters: known measurement filters as channel group to cut-off frequency, Hz (second-order Butterworth low-pass, as
    ArduPilot's INS_ACCEL_FILTER); derived: channel name to the sentence on how it was derived.
    autopilot: the board's own number, '' where it is not known;
    reference_clock: 'vehicle' when the reference is stamped on its arrival at the vehicle, 'ground' when by the ground: sent, or received.
    """

    source: str
    importer: str
    sha256: str = ""
    firmware: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    components: Components = field(default_factory=dict)
    vehicle: VehicleData = field(default_factory=VehicleData)
    clock: ClockData = field(default_factory=ClockData)
    losses: tuple[str, ...] = ()
    filters: Mapping[str, float] = field(default_factory=dict)
    derived: Mapping[str, str] = field(default_factory=dict)
    reference_clock: str = "vehicle"
    autopilot: str = ""

    @property
    def polled(self) -> frozenset[str]:
        """Channels taken for another, which were read off the autopilot at the logger's own times, not stamped as they changed."""
        return frozenset() if self.importer == "table" else frozenset(self.derived)


@dataclass(frozen=True)
class Recording:
    """One flight: series by group (see `channels.GROUPS`), markers in time order, provenance."""

    name: str
    series: Mapping[str, Series]
    markers: tuple[Marker, ...]
    provenance: Provenance

    def __repr__(self) -> str:
        groups = ", ".join(f"{name} {series.rate_hz:.0f} Hz" for name, series in self.series.items())
        start_s, end_s = self.t_span_s if any(map(len, self.series.values())) else (0.0, 0.0)
        return f"<Recording {self.name}: {end_s - start_s:.1f} s; {groups}; {len(self.markers)} markers>"

    def has(self, *channel_names: str) -> bool:
        """Whether every named channel is here with at least one finite sample; RecordingError for a name that is no channel's."""
        for name in channel_names:
            series = self._series_of(name)
            if series is None or name not in series.columns or not bool(np.any(np.isfinite(series.columns[name]))):
                return False
        return True

    def channel(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Time (n,) and values (n,) of one channel; RecordingError where it was not recorded."""
        series = self._series_of(name)
        if series is None or name not in series.columns:
            raise RecordingError(f"{self.name} has no channel {name}")
        return series.t_s, series.columns[name]

    def _series_of(self, channel: str) -> Series | None:
        if channel not in CHANNELS:
            near = get_close_matches(channel, CHANNELS, 1)
            hint = f"did you mean {near[0]!r}?" if near else "see the channel table in docs/formats.md"
            raise RecordingError(f"unknown channel {channel!r}", hint)
        return self.series.get(CHANNELS[channel].group)

    def to_frame(self, group: str | None = None) -> pd.DataFrame:
        """Channels as columns, indexed by t_s: of one group as they were sampled, or of all on the union of their times, NaN where a
        channel has no sample. RecordingError where the group was not recorded."""
        import pandas as pd

        if group is not None and group not in self.series:
            raise RecordingError(f"{self.name} has no group {group!r}", f"there are {', '.join(self.series)}")
        chosen = self.series if group is None else {group: self.series[group]}
        frames = [pd.DataFrame(dict(s.columns), index=pd.Index(s.t_s, name="t_s")) for s in chosen.values()]
        return pd.concat(frames, axis=1).sort_index() if frames else pd.DataFrame()

    def plot(self, *groups: str) -> go.Figure:
        """Channels over time, one panel per group: the named groups, else all. RecordingError where a group was not recorded."""
        from flighttest.plotting import over_time

        for group in groups:
            if group not in self.series:
                raise RecordingError(f"{self.name} has no group {group!r}", f"there are {', '.join(self.series)}")
        chosen = groups or tuple(self.series)
        return over_time({g: (self.series[g].t_s, self.series[g].columns) for g in chosen}, self.name)

    @property
    def t_span_s(self) -> tuple[float, float]:
        """First and last time of any series, s."""
        spans = [(float(s.t_s[0]), float(s.t_s[-1])) for s in self.series.values() if len(s)]
        if not spans:
            raise RecordingError(f"{self.name} is empty")
        return min(a for a, _ in spans), max(b for _, b in spans)
