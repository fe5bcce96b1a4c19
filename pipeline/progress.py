"""What a person sees on stderr while a run works: faults, counts by stage, time left.

On a terminal a live bar; elsewhere plain lines, at most one in a few seconds. Leaves to others: results (`report`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from .schedule import object_seconds, side_seconds
from .store import JobRecord

_SECONDS_BETWEEN_LINES = 5.0
_SIDE_STAGES = 3


class Reporter:
    """Tells on stderr how a run goes on.

    Parameters
    ----------
    console : by default stderr
    """

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console(stderr=True, soft_wrap=True, highlight=False)
        self._bar: Progress | None = None
        self._work = Work({}, {})
        self._start = self._last_line = monotonic()

    def say(self, text: str) -> None:
        """One line."""
        self.console.print(text, markup=False)

    def warn(self, text: str) -> None:
        """One line that asks for attention."""
        self.console.print(f"warning: {text}", markup=False, style="yellow")

    def fail(self, pair_id: str, reason: str) -> None:
        """One line for a pair that cannot be scored."""
        self._work.n_failed += 1
        self.console.print(f"pair {pair_id}: {reason}", markup=False, style="red")
        self._show()

    def start(self, n_raw: Mapping[str, int], n_jobs: Mapping[str, tuple[int, int]]) -> None:
        """Work on these pairs begins.

        Parameters
        ----------
        n_raw : points of both files by pair_id
        n_jobs : by stage, how many jobs there are and how many of them are done
        """
        self._work = Work(n_raw, n_jobs)
        self._start = self._last_line = monotonic()
        if self.console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.fields[stages]}", markup=False),
                BarColumn(bar_width=12),
                TimeElapsedColumn(),
                TextColumn("{task.fields[left]}", markup=False),
                console=self.console,
                transient=True,
            )
            self._bar.add_task("", total=1.0, stages="", left="")
            self._bar.start()
        self._show()

    def jobs_done(self, records: Iterable[JobRecord]) -> None:
        """Some jobs are finished."""
        for record in records:
            self._work.take(record)
        self._show()

    def pair_done(self, pair_id: str) -> None:
        """A pair has ended."""
        self._work.end(pair_id)
        self._show()

    def stop(self) -> None:
        """No more work."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _show(self) -> None:
        share, left = self._work.share(), self._work.time_left(monotonic() - self._start)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=share, stages=self._work.counts(), left=left)
        elif self._work.n_raw and monotonic() - self._last_line >= _SECONDS_BETWEEN_LINES:
            self._last_line = monotonic()
            self.say(f"{self._work.counts()}; {left}")


class Work:
    """How much work a run has, and how much of it is done, in rough seconds."""

    def __init__(self, n_raw: Mapping[str, int], n_jobs: Mapping[str, tuple[int, int]]) -> None:
        self.n_raw = n_raw
        self.n_failed = 0
        self._total = {stage: total for stage, (total, _) in n_jobs.items()}
        self._done = {stage: done for stage, (_, done) in n_jobs.items()}
        self._ended: set[str] = set()
        self._sides_done: dict[str, float] = {}
        self._objects: dict[str, float] = {}

    def take(self, record: JobRecord) -> None:
        """A job is finished."""
        if record.stage in self._done:
            self._done[record.stage] += 1
        if record.side:
            share = side_seconds(self.n_raw[record.pair_id] // 2) / _SIDE_STAGES
            self._sides_done[record.pair_id] = self._sides_done.get(record.pair_id, 0.0) + share
        elif record.stage == "matching":
            self._objects[record.pair_id] = sum(object_seconds(n) for _, n in record.facts["n_keep"])

    def end(self, pair_id: str) -> None:
        """A pair has ended, one way or the other."""
        self._ended.add(pair_id)

    def counts(self) -> str:
        """Ended pairs, and finished jobs of the first stages that are not through, in words."""
        open_stages = [stage for stage, total in self._total.items() if self._done[stage] < total]
        stages = ", ".join(f"{stage} {self._done[stage]}/{self._total[stage]}" for stage in open_stages[:3])
        pairs = f"{len(self._ended)} of {len(self.n_raw)} pairs, {self.n_failed} failed"
        return f"{pairs} ({stages})" if stages else pairs

    def share(self) -> float:
        """Done work over all work."""
        done, total = self._seconds()
        return done / total if total else 1.0

    def time_left(self, elapsed_s: float) -> str:
        """The time left, in words, if the work goes on as fast as until now."""
        done, total = self._seconds()
        if done <= 0 or elapsed_s < 1:
            return "time left unknown"
        left = elapsed_s * (total - done) / done
        return f"about {left:.0f} s left" if left < 90 else f"about {left / 60:.0f} min left"

    def _seconds(self) -> tuple[float, float]:
        sides = {pair_id: 2 * side_seconds(n // 2) for pair_id, n in self.n_raw.items()}
        known = [self._objects[pair_id] / sides[pair_id] for pair_id in self._objects]
        usual = sum(known) / len(known) if known else 1.0
        done = total = 0.0
        for pair_id, side in sides.items():
            objects = self._objects.get(pair_id, usual * side)
            total += side + objects
            done += side + objects if pair_id in self._ended else min(side, self._sides_done.get(pair_id, 0.0))
        return done, total
