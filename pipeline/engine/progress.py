"""What a person sees on stderr while a run works: faults, counts by stage, time left.

On a terminal a live bar; elsewhere plain lines, at most one in a few seconds. While nothing ends, because one large
object is being scored, the time left counts down. Leaves to others: what tasks cost (`costs`), results (`report`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from threading import Event, RLock, Thread
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..storage.ledger import JobRecord
from .costs import object_seconds, side_seconds

SECONDS_BETWEEN_LINES = 5.0
_SECONDS_OF_SILENCE = 30.0
_SECONDS_BETWEEN_LOOKS = 1.0
_SIDE_STAGES = 3


def words_of_time_left(seconds: float) -> str:
    """So many seconds as a person says it."""
    return f"about {seconds:.0f} s left" if seconds < 90 else f"about {seconds / 60:.0f} min left"


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
        self._last_line = monotonic()
        self._lock = RLock()
        self._ended = Event()
        self._clock: Thread | None = None

    def say(self, text: str) -> None:
        """One line."""
        self.console.print(text, markup=False)

    def warn(self, text: str) -> None:
        """One line that asks for attention."""
        self.console.print(f"warning: {text}", markup=False, style="yellow")

    def fail(self, pair_id: str, reason: str) -> None:
        """One line for a pair that cannot be scored."""
        self.console.print(f"pair {pair_id}: {reason}", markup=False, style="red")
        with self._lock:
            self._work.n_failed += 1
            self._show()

    def start(self, n_raw: Mapping[str, int], n_jobs: Mapping[str, tuple[int, int]]) -> None:
        """Work on these pairs begins.

        Parameters
        ----------
        n_raw : points of both files by pair_id
        n_jobs : by stage, how many jobs there are and how many of them are done
        """
        self._work = Work(n_raw, n_jobs)
        self._last_line = monotonic()
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
        self._ended.clear()
        self._clock = Thread(target=self._tick, name="progress", daemon=True)
        self._clock.start()

    def jobs_done(self, records: Iterable[JobRecord]) -> None:
        """Some jobs are finished."""
        with self._lock:
            for record in records:
                self._work.take(record)
            self._show()

    def objects_done(self, pair_id: str, n_keep: Iterable[int]) -> None:
        """Some objects of a pair are scored, of so many nodes."""
        with self._lock:
            self._work.take_objects(pair_id, n_keep)
            self._show()

    def pair_done(self, pair_id: str) -> None:
        """A pair has ended."""
        with self._lock:
            self._work.end(pair_id)
            self._show()

    def stop(self) -> None:
        """No more work."""
        self._ended.set()
        if self._clock is not None:
            self._clock.join()
            self._clock = None
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def _tick(self) -> None:
        """Counts the time down while nothing ends."""
        while not self._ended.wait(_SECONDS_BETWEEN_LOOKS):
            with self._lock:
                self._show(_SECONDS_OF_SILENCE)

    def _show(self, seconds_between_lines: float = SECONDS_BETWEEN_LINES) -> None:
        now = monotonic()
        if self._bar is not None:
            counts, left = self._work.counts(), self._work.time_left(now)
            self._bar.update(self._bar.task_ids[0], completed=self._work.share(), stages=counts, left=left)
        elif self._work.n_raw and now - self._last_line >= seconds_between_lines:
            self._last_line = now
            self.say(f"{self._work.counts()}; {self._work.time_left(now)}")


class Work:
    """How much work a run has, and how much of it is done, in rough seconds; and how long these take here."""

    def __init__(self, n_raw: Mapping[str, int], n_jobs: Mapping[str, tuple[int, int]]) -> None:
        self.n_raw = n_raw
        self.n_failed = 0
        self._total = {stage: total for stage, (total, _) in n_jobs.items()}
        self._done = {stage: done for stage, (_, done) in n_jobs.items()}
        self._n_ended = 0
        self._sides = {pair_id: 2 * side_seconds(n // 2) for pair_id, n in n_raw.items()}
        self._objects: dict[str, float] = {}
        self._all_sides_s, self._known_sides_s, self._known_objects_s = sum(self._sides.values()), 0.0, 0.0
        self._done_s, self._done_of = 0.0, dict[str, float]()
        self._start = self._last = monotonic()

    def take(self, record: JobRecord) -> None:
        """A job is finished."""
        pair_id = record.pair_id
        if record.stage in self._done:
            self._done[record.stage] += 1
        if record.side:
            self._add(pair_id, self._sides[pair_id] / 2 / _SIDE_STAGES)
        elif record.stage == "matching" and pair_id not in self._objects:
            seconds = sum(object_seconds(n) for _, n in record.facts["n_keep"])
            self._objects[pair_id] = seconds
            self._known_objects_s += seconds
            self._known_sides_s += self._sides[pair_id]
        self._last = monotonic()

    def take_objects(self, pair_id: str, n_keep: Iterable[int]) -> None:
        """Some objects of a pair are scored."""
        self._add(pair_id, sum(object_seconds(n) for n in n_keep))
        self._last = monotonic()

    def end(self, pair_id: str) -> None:
        """A pair has ended, one way or the other."""
        self._n_ended += 1
        if pair_id not in self._objects:  # failed before its objects were known
            self._known_sides_s += self._sides[pair_id]
        self._add(pair_id, self._sides[pair_id] + self._objects.get(pair_id, 0.0) - self._done_of.get(pair_id, 0.0))
        self._last = monotonic()

    def counts(self) -> str:
        """Ended pairs, and finished jobs of the first stages that are not through, in words."""
        open_stages = [stage for stage, total in self._total.items() if self._done[stage] < total]
        stages = ", ".join(f"{stage} {self._done[stage]}/{self._total[stage]}" for stage in open_stages[:3])
        pairs = f"{self._n_ended} of {len(self.n_raw)} pairs, {self.n_failed} failed"
        return f"{pairs} ({stages})" if stages else pairs

    def share(self) -> float:
        """Done work over all work."""
        done, total = self._seconds()
        return min(1.0, done / total) if total else 1.0

    def time_left(self, now: float) -> str:
        """The time left, in words: the pace is that of the work until the last task ended; from there it counts down.

        Parameters
        ----------
        now : seconds, of the monotonic clock
        """
        done, total = self._seconds()
        if done <= 0 or now - self._start < 1:
            return "time left unknown"
        left = (self._last - self._start) * (total - done) / done - (now - self._last)
        if left < 1:
            return "a large object takes longer than expected" if done < total else "about 0 s left"
        return words_of_time_left(left)

    def _add(self, pair_id: str, seconds: float) -> None:
        self._done_of[pair_id] = self._done_of.get(pair_id, 0.0) + seconds
        self._done_s += seconds

    def _seconds(self) -> tuple[float, float]:
        """Done work and all work; pairs whose objects are not known yet have as many a point as the others."""
        usual = self._known_objects_s / self._known_sides_s if self._known_sides_s else 1.0
        unknown = usual * (self._all_sides_s - self._known_sides_s)
        return self._done_s, self._all_sides_s + self._known_objects_s + unknown
