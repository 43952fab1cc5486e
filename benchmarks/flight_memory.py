"""Memory of the program while it flies: resident size over the vehicle's time, on the built-in vehicle.

python benchmarks/flight_memory.py [SCRIPT...]    (default: thrust twice, about half an hour of the vehicle's time)
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from flighttest.pipeline.flights import run as flying


def resident_mb() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return float(line.split()[1]) / 1024.0
    return 0.0


class Watch:
    """Prints the resident size once a minute of the vehicle's time."""

    def __init__(self) -> None:
        self.next_s = 0.0
        self.seen: list[tuple[float, float]] = []

    def stage(self, text: str) -> None:
        print(f"            {resident_mb():6.1f} MB  {text}", flush=True)
        self.next_s = 0.0

    def flight(self, progress: object) -> None:
        t_s: float = progress.t_s  # type: ignore[attr-defined]
        if t_s >= self.next_s:
            self.next_s = t_s + 60.0
            self.seen.append((t_s, resident_mb()))
            print(f"{t_s / 60.0:8.1f} min {self.seen[-1][1]:6.1f} MB", flush=True)


def main() -> None:
    watch = Watch()
    with tempfile.TemporaryDirectory() as folder:
        request = flying.FlightRequest(tuple(sys.argv[1:]) or ("thrust",), out=Path(folder), fly_only=True)
        flying.run(request, watch)
    (t0, m0), (t1, m1) = watch.seen[1], watch.seen[-1]
    print(f"grew by {(m1 - m0) / (t1 - t0) * 60.0:.2f} MB a minute over {(t1 - t0) / 60.0:.0f} min")


if __name__ == "__main__":
    main()
