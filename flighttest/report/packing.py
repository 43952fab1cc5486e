"""Data inside a page: compressed, and as text that a page can hold; unpack.js reads it. Levels of detail of long channels."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import plotly
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from flighttest.segments.health import GAP_TIMES

FloatArray = NDArray[np.float64]
MISSING = -32768
LEAST_GAP_S = 0.25  # a shorter one no picture of a flight shows
STEPS, MIDDLE = 65000, 32500  # of a value between a channel's smallest and largest: 16 bits
LEAST_COLUMN = 12  # shorter columns of numbers stay in the text
MAP_WORKER = re.compile(r"""exports='(?:[^'\\]|\\.)*maplibre-gl-worker(?:[^'\\]|\\.)*'""")


def packed(data: bytes, key: str) -> str:
    """A script element that holds the bytes: gzip, then base 85, which has no sign that would end it."""
    return _element(gzip.compress(data, 9, mtime=0), key)


def _element(small: bytes, key: str) -> str:
    text = base64.b85encode(small + b"\0" * (-len(small) % 4)).decode("ascii")
    return f'<script type="text/plain" id="{key}" data-bytes="{len(small)}">{text}</script>'


def packed_json(data: Any, key: str) -> str:
    """The same of plain JSON types."""
    return packed(json.dumps(data, separators=(",", ":")).encode(), key)


class PanelSpec(TypedDict):
    """What Plotly.newPlot takes: traces and layout as of plotly.js, whose keys are its own."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    title: str


class LegendEntry(TypedDict):
    """One name of a figure's legend."""

    name: str
    role: str
    dash: str
    shown: bool


class FigureSpec(TypedDict):
    """A figure as a page holds it; heights in px."""

    id: str
    caption: str
    columns: int
    height: int
    legend: list[LegendEntry]
    panels: list[PanelSpec]


class PackedChannel(TypedDict):
    """Where a channel's 16-bit numbers begin, and what they mean: value = low + (number + MIDDLE) * step."""

    name: str
    at: int
    low: float
    step: float


class PackedGroup(TypedDict):
    """Channels over one time base: where its steps of 10 us begin, their number, the first time, s, and how many samples there were."""

    group: str
    t: int
    n: int
    t0: float
    of: int
    channels: list[PackedChannel]


def packed_figures(specs: Sequence[FigureSpec], key: str) -> str:
    """Specifications of figures, their long columns of numbers apart as binary, each once: a time axis is shared by many traces.

    A column becomes {"at", "n"} and, of 16 bits, {"low", "step"}; on logarithmic axes it keeps 32-bit floats.
    """
    parts: list[bytes] = []
    known: dict[Any, dict[str, Any]] = {}
    size = 0

    def put(values: list[Any], whole: bool) -> Any:
        nonlocal size
        if len(values) < LEAST_COLUMN or not all(v is None or isinstance(v, int | float) for v in values):
            return values
        name = (whole, tuple(values))
        if name not in known:
            array = np.array([np.nan if v is None else v for v in values])
            entry: dict[str, Any] = {"at": size, "n": array.size}
            if whole:
                coded: NDArray[Any] = array.astype("<f4")
            else:
                coded, entry["low"], entry["step"] = _coded(array)
            parts.append(coded.tobytes() + b"\0" * (-coded.nbytes % 4))
            size += len(parts[-1])
            known[name] = entry
        return known[name]

    thin = []
    for spec in specs:
        panels = []
        for panel in spec["panels"]:
            axes = panel["layout"]
            log = {a: axes.get(f"{a}axis", {}).get("type") == "log" for a in "xyz"}
            data = [
                {
                    k: put(v, log[k]) if k in log and isinstance(v, list) and trace["type"] != "heatmap" else v
                    for k, v in trace.items()
                }
                for trace in panel["data"]
            ]
            panels.append({**panel, "data": data})
        thin.append({**spec, "panels": panels})
    return packed_json(thin, key) + packed(b"".join(parts), f"{key}-data")


def _coded(values: FloatArray) -> tuple[NDArray[np.int16], float, float]:
    """16-bit numbers, the smallest value and the step: value = low + (number + MIDDLE) * step; what is not finite is MISSING."""
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    step = (high - low) / STEPS or 1.0
    coded = np.full(values.size, MISSING, dtype="<i2")
    coded[known] = np.round((values[known] - low) / step) - MIDDLE
    return coded, low, step


def unpacked(page: str, key: str) -> bytes:
    """What a page holds under a key."""
    head, _, rest = page.partition(f'id="{key}" data-bytes="')[2].partition('">')
    return gzip.decompress(base64.b85decode(rest.partition("</script>")[0])[: int(head)])


def plotly_without_maps() -> str:
    """plotly's own script less the program that draws street maps in a second thread, a tenth of it, which no page of ours uses."""
    return MAP_WORKER.sub("exports=''", get_plotlyjs())


@lru_cache(maxsize=1)
def plotly_script() -> str:
    """plotly's script (`plotly_without_maps`), packed under `packed-plotly`: kept in the user's cache, since packing 4 MB takes a
    second."""
    script = plotly_without_maps().encode()
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    path = Path(cache) / "flighttest" / f"plotly-{plotly.__version__}.gz"
    with suppress(OSError, EOFError, gzip.BadGzipFile):
        small = path.read_bytes()
        if gzip.decompress(small) == script:
            return _element(small, "packed-plotly")
    small = gzip.compress(script, 9, mtime=0)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_bytes(small)
        os.replace(part, path)
    return _element(small, "packed-plotly")


def coarse(t_s: FloatArray, values: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest value of equal pieces of time in their order, at most `most` samples (n,), so that no peak is lost; as it is
    where it is short enough."""
    if t_s.size <= most:
        return t_s, values
    pieces = most // 2
    edges = np.linspace(t_s[0], t_s[-1], pieces + 1)
    which = np.clip(np.searchsorted(edges, t_s, "right") - 1, 0, pieces - 1)
    starts = np.flatnonzero(np.diff(which, prepend=-1))
    low = np.fmin.reduceat(values, starts)
    high = np.fmax.reduceat(values, starts)
    rising = values[np.append(starts[1:], values.size) - 1] >= values[starts]
    width = (edges[1] - edges[0]) / 2.0
    at = edges[which[starts]]
    times = np.stack([at + 0.5 * width, at + 1.5 * width], axis=1).ravel()
    return times, np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1).ravel()


def _with_breaks(t_s: FloatArray, columns: Mapping[str, FloatArray]) -> tuple[FloatArray, Mapping[str, FloatArray]]:
    """A sample without a value in the middle of every gap, so that no line is drawn where nothing was recorded."""
    steps = np.diff(t_s)
    if not steps.size:
        return t_s, columns
    gaps = np.flatnonzero(steps > max(GAP_TIMES * float(np.median(steps)), LEAST_GAP_S))
    middle = t_s[gaps] + steps[gaps] / 2.0
    return np.insert(t_s, gaps + 1, middle), {n: np.insert(v, gaps + 1, np.nan) for n, v in columns.items()}


def pack_series(
    groups: Mapping[str, tuple[FloatArray, Mapping[str, FloatArray]]], most: int
) -> tuple[list[PackedGroup], bytes]:
    """Channels as 16-bit numbers over 10-microsecond steps of time: where each lies, and the bytes. most: samples per channel."""
    described: list[PackedGroup] = []
    parts: list[bytes] = []
    size = 0

    def add(array: NDArray[Any]) -> int:
        nonlocal size
        data = array.tobytes() + b"\0" * (-array.nbytes % 4)
        parts.append(data)
        size += len(data)
        return size - len(data)

    for group, (recorded_s, recorded) in groups.items():
        t_s, columns = _with_breaks(recorded_s, recorded)
        thin: dict[str, FloatArray] = {}
        times = t_s
        for name, values in columns.items():
            times, thin[name] = coarse(t_s, values, most)
        ticks = np.round((times - times[0]) * 1e5).astype(np.int64)
        deltas = np.diff(ticks, prepend=0).astype("<u4")
        entry: PackedGroup = {
            "group": group,
            "t": add(deltas),
            "n": int(times.size),
            "t0": float(times[0]),
            "of": int(recorded_s.size),
            "channels": [],
        }
        for name, values in thin.items():
            coded, low, step = _coded(values)
            entry["channels"].append({"name": name, "at": add(coded), "low": low, "step": step})
        described.append(entry)
    return described, b"".join(parts)
