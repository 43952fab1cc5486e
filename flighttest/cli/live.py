"""Progress while something goes on: a live picture on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any

from rich.live import Live

from flighttest.cli.show import Show
from flighttest.report.flight_large import large
from flighttest.report.render.flight_view import line, picture

PLAIN_EVERY_S = 10.0
# A terminal that is gone, or a reader (tee, less) that Ctrl-C ended with us, must not end a flight; rich leaves the program for it.
_NOBODY_READS = (OSError, SystemExit)


class LiveProgress:
    """Implements `pipeline.results.Progress`. Use as a context manager, so that the terminal is left as it was.

    clock: seconds, injected by tests. view: normal, or large to be read from afar.
    """

    def __init__(self, show: Show, clock: Callable[[], float] = time.monotonic, view: str = "normal") -> None:
        self._show = show
        self._picture_of = large if view == "large" else picture
        self._alarms = 0
        self._clock = clock
        self._started_s = clock()
        self._live: Live | None = None
        self._last_line_s = -float("inf")

    def __enter__(self) -> LiveProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def stage(self, text: str) -> None:
        """A new step of the pipeline begins: one line with the time since the start."""
        with suppress(*_NOBODY_READS):
            self._stop()
            self._show.say(f"{self._clock() - self._started_s:6.1f} s  {text}", style="quiet")

    def flight(self, progress: Any) -> None:
        """The flight went on: redraw the picture, or now and then a line."""
        with suppress(*_NOBODY_READS):
            if progress.alarms > self._alarms:
                self._alarms = progress.alarms
                self._show.alarm(f"{self._clock() - self._started_s:6.1f} s  {progress.alarm}")
            self._picture(progress)

    def _picture(self, progress: Any) -> None:
        if self._show.live and progress.legs:
            if self._live is None:
                self._live = Live(console=self._show.side, refresh_per_second=8, transient=True)
                self._live.start()
            self._live.update(self._picture_of(progress))
        if self._show.live:
            return
        now_s = self._clock()
        if progress.legs and now_s - self._last_line_s >= PLAIN_EVERY_S:
            self._last_line_s = now_s
            self._show.say(f"{now_s - self._started_s:6.1f} s  {line(progress)}")

    def _stop(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None
