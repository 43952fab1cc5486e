"""Progress while something goes on: a live picture on a terminal, plain lines elsewhere.

A stage that takes longer than a moment shows its share and the time left: by the pieces done where they are counted, else by how long
the like took last time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import TracebackType
from typing import Any

from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table as Grid
from rich.text import Text

from flighttest.cli.durations import Durations, default_path
from flighttest.cli.show import Show
from flighttest.report.numbers import duration
from flighttest.report.render.flight_large import large
from flighttest.report.render.flight_view import line, picture

PLAIN_EVERY_S = 10.0
SHOWN_FROM_S = 0.7  # a stage that is shorter is one line only
BAR_WIDTH = 24
# A terminal that is gone, or a reader (tee, less) that Ctrl-C ended with us, must not end a flight; rich leaves the program for it.
_OUTPUT_CLOSED = (OSError, SystemExit)


@contextmanager
def without_echoed_controls(file: int) -> Iterator[None]:
    """Without the terminal's own "^C": it moves the cursor, from which a live picture is erased upwards. Nothing where file is none."""
    try:
        import termios

        before = termios.tcgetattr(file)
    except (ImportError, OSError, termios.error):  # not on this system, or no terminal
        yield
        return
    flags = list(before)
    flags[3] &= ~termios.ECHOCTL
    termios.tcsetattr(file, termios.TCSANOW, flags)
    try:
        yield
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(file, termios.TCSANOW, before)


class LiveProgress:
    """Implements `flighttest.Progress`. Use as a context manager, so that the terminal is left as it was.

    clock: seconds; durations: of earlier stages; both injected by tests. view: normal, or large to be read from afar. keep: stages stay
    on a terminal above the answer, as those of a flight do; otherwise only with `-v`, so that an answer is one screen.
    """

    def __init__(
        self,
        show: Show,
        clock: Callable[[], float] = time.monotonic,
        durations: Durations | None = None,
        view: str = "normal",
        keep: bool = False,
    ) -> None:
        self._show = show
        self._keep = keep or show.everything or not show.live
        self._picture_of = large if view == "large" else picture
        self._alarms = 0
        self._clock = clock
        self._started_s = clock()
        self._live: Live | None = None
        self._flying = False
        self._asking = False
        self._last_line_s = -float("inf")
        self._durations = durations or Durations(default_path())
        self._stage, self._stage_s = "", self._started_s
        self._part: tuple[float, float] | None = None
        self._held = ExitStack()

    def __enter__(self) -> LiveProgress:
        if self._show.live:
            with suppress(OSError, ValueError, AttributeError):  # no file behind it
                self._held.enter_context(without_echoed_controls(sys.stdin.fileno()))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(*_OUTPUT_CLOSED):
            self._stop()
        self._held.close()
        if kind is None:
            self._timed()

    def stage(self, text: str) -> None:
        """A new step of the pipeline begins: one line with the time since the start, which stays where stages are kept."""
        with suppress(*_OUTPUT_CLOSED):
            self._stop()
            self._timed()
            if self._asking:  # Ctrl-C was the answer: the line of the question has not ended
                self._show.say("")
            if self._keep:
                self._show.say(f"{self._clock() - self._started_s:6.1f} s  {text}", style="quiet")
            self._stage, self._stage_s, self._part = text, self._clock(), None
            if self._show.live:
                self._live = Live(
                    console=self._show.side, refresh_per_second=4, transient=True, get_renderable=self.bar
                )
                self._live.start()

    def ask(self, text: str) -> bool:
        """Show a text and ask for a yes (`Show.ask`). The stage's bar is taken away before: it would be drawn over the question."""
        with suppress(*_OUTPUT_CLOSED):
            self._stop()
            self._stage = ""  # the time that an answer takes belongs to no stage
        self._asking = True
        answer = self._show.ask(text)
        self._asking = False
        return answer

    def part(self, done: float, of: float) -> None:
        """So many pieces of the stage are done."""
        self._part = (done, of)
        now_s = self._clock()
        waited_s = now_s - max(self._last_line_s, self._stage_s)
        if not self._show.live and waited_s >= PLAIN_EVERY_S and (words := self.words()):
            self._last_line_s = now_s
            with suppress(*_OUTPUT_CLOSED):
                self._show.say(f"{now_s - self._started_s:6.1f} s  {self._stage}: {words}", style="quiet")

    def share(self) -> float | None:
        """How much of the stage is done, None where it is not known."""
        if self._part is not None and self._part[1] > 0:
            return min(self._part[0] / self._part[1], 1.0)
        expected_s = self._durations.expected_s(self._stage)
        share = (self._clock() - self._stage_s) / expected_s if expected_s else 1.0
        return share if share < 1.0 else None  # one that takes longer than last time: how much longer is not known

    def words(self) -> str:
        """'40 %, about 12 s left', or how long it has taken where its share is not known; nothing of a short stage."""
        took_s = self._clock() - self._stage_s
        if took_s < SHOWN_FROM_S:
            return ""
        share = self.share()
        if share is None:
            return f"{took_s:.0f} s so far"
        if not share:
            return "0 %"
        return f"{share:.0%}, about {duration(took_s * (1.0 - share) / share)} left"

    def bar(self) -> Grid:
        """The stage as a bar with its words, empty while it is short; below its line where that is not kept."""
        grid = Grid.grid(padding=(0, 2, 0, 0))
        words = self.words()
        if words:
            share = self.share()
            drawn = ProgressBar(1.0, share or 0.0, width=BAR_WIDTH, pulse=share is None)
            grid.add_row(Text(" " * 7), drawn, Text(words, style="quiet"))
        if self._keep:
            return grid
        stage = Grid.grid()
        stage.add_row(Text(f"{self._clock() - self._started_s:6.1f} s  {self._stage}", style="quiet"))
        stage.add_row(grid)
        return stage

    def _timed(self) -> None:
        """Keep how long the stage took that ends now."""
        took_s = self._clock() - self._stage_s
        if self._stage and took_s >= SHOWN_FROM_S:
            self._durations.took(self._stage, took_s)
        self._stage = ""

    def flight(self, progress: Any) -> None:
        """The flight went on: redraw the picture, or now and then a line."""
        with suppress(*_OUTPUT_CLOSED):
            if progress.alarms > self._alarms:
                self._alarms = progress.alarms
                self._show.alarm(f"{self._clock() - self._started_s:6.1f} s  {progress.alarm}")
            self._picture(progress)

    def _picture(self, progress: Any) -> None:
        if self._show.live and progress.legs:
            if not self._flying:
                self._stop()
                self._stage = ""  # how long a flight takes is shown by its picture
                self._live = Live(console=self._show.side, refresh_per_second=8, transient=True)
                self._live.start()
                self._flying = True
            if self._live is not None:
                self._live.update(self._picture_of(progress))
        if self._show.live:
            return
        now_s = self._clock()
        if progress.legs and now_s - self._last_line_s >= PLAIN_EVERY_S:
            self._last_line_s = now_s
            self._show.say(f"{now_s - self._started_s:6.1f} s  {line(progress)}")

    def _stop(self) -> None:
        if self._live is not None:
            with suppress(IndexError):  # Ctrl-C while it began: it holds nothing of the terminal yet
                self._live.stop()
            self._show.side.show_cursor(True)
            self._live = None
        self._flying = False
