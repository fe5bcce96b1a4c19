"""What a person sees on stderr while work goes on: faults, counts by stage, time left.

On a terminal a live bar; elsewhere plain lines, at most one in a few seconds. While nothing ends, because one large
object is being scored, the time left counts down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from threading import Event, RLock, Thread
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..stage import OBJECTS, Grain
from ..storage.tables import JobRecord
from ..terminal import Terminal, shown
from .costs import CostModel
from .plan import PairPlan
from .worker import BatchResult, JobFailure

SECONDS_BETWEEN_LINES = 5.0
_SECONDS_OF_SILENCE = 30.0
_SECONDS_BETWEEN_LOOKS = 1.0


class Reporter:
    """Tells on stderr how the work goes on.

    Parameters
    ----------
    console : by default stderr
    seconds_between_lines, seconds_of_silence : where there is no terminal, how often something is said at most, and
        at least
    """

    def __init__(
        self,
        console: Console | None = None,
        *,
        seconds_between_lines: float = SECONDS_BETWEEN_LINES,
        seconds_of_silence: float = _SECONDS_OF_SILENCE,
    ) -> None:
        self.console = console or Terminal(stderr=True, soft_wrap=True)
        self._bar: Progress | None = None
        self._work = Work(0, 0.0, {})
        self._between, self._silence = seconds_between_lines, seconds_of_silence
        self._last_line = monotonic()
        self._lock = RLock()
        self._ended = Event()
        self._clock: Thread | None = None

    def say(self, text: str) -> None:
        """One line."""
        self.console.print(text, markup=False)

    def warn(self, text: str) -> None:
        """One line that asks for attention."""
        self.console.print(f"warning: {shown(text)}", markup=False, style="yellow")

    def fail(self, name: str, reason: str) -> None:
        """One line for what came to nothing."""
        self.console.print(shown(f"{name}: {reason}"), markup=False, style="red")
        with self._lock:
            self._work.n_failed += 1
            self._show()

    def start(self, work: Work) -> None:
        """Work begins."""
        self._work = work
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

    def pair_begun(self, plan: PairPlan) -> None:
        """A pair is begun."""
        with self._lock:
            self._work.begin(plan)

    def batch_done(self, result: BatchResult) -> None:
        """Some jobs of a pair are finished."""
        with self._lock:
            for record in result.records:
                self._work.take(record)
            self._show()

    def objects_done(self, pair_id: str, n_keep: Iterable[int]) -> None:
        """Some objects of a pair are scored, of so many nodes."""
        with self._lock:
            self._work.take_objects(pair_id, n_keep)
            self._show()

    def pair_done(self, plan: PairPlan, failures: tuple[JobFailure, ...]) -> None:
        """A pair has ended."""
        with self._lock:
            self._work.end(plan.pair_id)
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
        while not self._ended.wait(min(_SECONDS_BETWEEN_LOOKS, self._silence)):
            with self._lock:
                self._show(self._silence)

    def _show(self, seconds_between_lines: float | None = None) -> None:
        now = monotonic()
        between = self._between if seconds_between_lines is None else seconds_between_lines
        if self._bar is not None:
            counts, left = self._work.counts(), self._work.time_left(now)
            self._bar.update(self._bar.task_ids[0], completed=self._work.share(), stages=counts, left=left)
        elif self._work.n_pairs and now - self._last_line >= between:
            self._last_line = now
            self.say(f"{self._work.counts()}; {self._work.time_left(now)}")


@dataclass
class _PairWork:
    """The work of a pair that is begun, in rough seconds.

    sides_s : of its two sides
    objects_s : of its objects, once they are known
    parts_s : of parts of experiments, by stage and part
    """

    sides_s: float
    n_side_jobs: int
    objects_s: float | None = None
    parts_s: dict[tuple[str, str], float] = field(default_factory=dict)
    done_s: float = 0.0


class Work:
    """How much work there is, and how much of it is done, in rough seconds; and how long these take here.

    Parameters
    ----------
    n_pairs : with jobs to be made
    seconds : of all their sides, and of all parts of experiments
    n_jobs : by stage, how many jobs there are and how many of them are done
    costs : the cost model
    clock : seconds that never run backwards
    """

    def __init__(
        self,
        n_pairs: int,
        seconds: float,
        n_jobs: Mapping[str, tuple[int, int]],
        costs: CostModel | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.n_pairs = n_pairs
        self.n_failed = 0
        self._costs = costs or CostModel()
        self._total = {stage: total for stage, (total, _) in n_jobs.items()}
        self._done = {stage: done for stage, (_, done) in n_jobs.items()}
        self._n_ended = 0
        self._pairs: dict[str, _PairWork] = {}
        self._all_s, self._known_sides_s, self._known_objects_s, self._done_s = seconds, 0.0, 0.0, 0.0
        self._parts_s = 0.0
        self._clock = clock
        self._start = self._last = clock()

    def begin(self, plan: PairPlan) -> None:
        """A pair is begun."""
        sides_s, parts_s = seconds_of(plan, self._costs)
        n_side_jobs = sum(job.stage.grain is Grain.SIDE for job in plan.jobs)
        self._pairs[plan.pair_id] = _PairWork(sides_s, n_side_jobs, parts_s=parts_s)
        self._parts_s += sum(parts_s.values())
        if plan.objects is not None and not parts_s:
            self._know_objects(self._pairs[plan.pair_id], plan.objects)

    def take(self, record: JobRecord) -> None:
        """A job is finished."""
        pair = self._pairs[record.pair_id]
        if record.stage in self._done:
            self._done[record.stage] += 1
        if (record.stage, record.part) in pair.parts_s:
            self._add(pair, pair.parts_s[record.stage, record.part])
        elif record.part:
            self._add(pair, pair.sides_s / pair.n_side_jobs)
        elif OBJECTS in record.facts and pair.objects_s is None:
            self._know_objects(pair, record.facts[OBJECTS])
        self._last = self._clock()

    def take_objects(self, pair_id: str, n_keep: Iterable[int]) -> None:
        """Some objects of a pair are scored."""
        self._add(self._pairs[pair_id], sum(self._costs.object_seconds(n) for n in n_keep))
        self._last = self._clock()

    def end(self, pair_id: str) -> None:
        """A pair has ended, one way or the other."""
        self._n_ended += 1
        pair = self._pairs.pop(pair_id)
        if pair.objects_s is None:  # failed before its objects were known, or has none to be scored
            self._known_sides_s += pair.sides_s
        self._add(pair, pair.sides_s + (pair.objects_s or 0.0) + sum(pair.parts_s.values()) - pair.done_s)
        self._last = self._clock()

    def counts(self) -> str:
        """Ended pairs, and finished jobs of the first stages that are not through, in words."""
        open_stages = [stage for stage, total in self._total.items() if self._done[stage] < total]
        stages = ", ".join(f"{stage} {self._done[stage]}/{self._total[stage]}" for stage in open_stages[:3])
        pairs = f"{self._n_ended} of {self.n_pairs} pairs, {self.n_failed} failed"
        return f"{pairs} ({stages})" if stages else pairs

    def share(self) -> float:
        """Done work over all work, 0 to 1."""
        total = self._total_seconds()
        return min(1.0, self._done_s / total) if total else 1.0

    def time_left(self, now: float) -> str:
        """The time left, in words: the pace is that of the work until the last task ended; from there it counts down.

        Parameters
        ----------
        now : by the same clock
        """
        done, total = self._done_s, self._total_seconds()
        if done <= 0 or now - self._start < 1:
            return "time left unknown"
        left = (self._last - self._start) * (total - done) / done - (now - self._last)
        if left < 1:
            return "a large object takes longer than expected" if done < total else "about 0 s left"
        return f"about {left:.0f} s left" if left < 90 else f"about {left / 60:.0f} min left"

    def _know_objects(self, pair: _PairWork, objects: Iterable[tuple[int, int]]) -> None:
        pair.objects_s = sum(self._costs.object_seconds(n) for _, n in objects)
        self._known_objects_s += pair.objects_s
        self._known_sides_s += pair.sides_s

    def _add(self, pair: _PairWork, seconds: float) -> None:
        pair.done_s += seconds
        self._done_s += seconds

    def _total_seconds(self) -> float:
        """All work; pairs whose objects are not known yet have as many per point as the others."""
        usual = self._known_objects_s / self._known_sides_s if self._known_sides_s else 1.0
        unknown = 0.0 if self._parts_s else usual * (self._all_s - self._known_sides_s)
        return self._all_s + self._known_objects_s + unknown


def seconds_of(plan: PairPlan, costs: CostModel) -> tuple[float, dict[tuple[str, str], float]]:
    """Rough seconds of a pair's open work: of its two sides, and of each part of an experiment."""
    todo = plan.todo
    parts_s = {job.name: job.seconds for job in todo if job.part not in job.stage.parts}
    is_parts_alone = len(parts_s) == len(todo)
    return (0.0 if is_parts_alone else 2 * costs.side_seconds(plan.n_raw // 2)), parts_s
