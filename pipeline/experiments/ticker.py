"""What a person sees on stderr while an experiment works: how many jobs are done, and the time left."""

from __future__ import annotations

from time import monotonic
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..engine.progress import SECONDS_BETWEEN_LINES, words_of_time_left

_SURE_SHARE = 0.05  # before that a guess of the time left is worth nothing


class Ticker:
    """Counts jobs: on a terminal with a live bar, elsewhere with a plain line every few seconds.

    Parameters
    ----------
    console : stderr
    n_jobs, cost_s : how many jobs, and what they cost together by a rough guess
    """

    def __init__(self, console: Console, n_jobs: int, cost_s: float) -> None:
        self._console = console
        self._n_jobs, self._cost_s = n_jobs, cost_s
        self._n_done, self._done_s = 0, 0.0
        self._start = self._last_line = monotonic()
        self._bar = Progress(
            TextColumn("{task.fields[words]}", markup=False),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )

    def __enter__(self) -> Ticker:
        self._bar.start()
        self._bar.add_task("", total=self._cost_s, words=self._words())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def done(self, cost_s: float) -> None:
        """One more job has ended."""
        self._n_done += 1
        self._done_s += cost_s
        now = monotonic()
        self._bar.update(self._bar.task_ids[0], completed=self._done_s, words=self._words())
        if not self._console.is_terminal and now - self._last_line >= SECONDS_BETWEEN_LINES:
            self._last_line = now
            self._console.print(self._words(), markup=False)

    def _words(self) -> str:
        elapsed = monotonic() - self._start
        words = f"{self._n_done} of {self._n_jobs} jobs"
        if self._done_s < _SURE_SHARE * self._cost_s or elapsed < 1:
            return words
        left = elapsed * (self._cost_s - self._done_s) / self._done_s
        return f"{words}, {words_of_time_left(left)}"
