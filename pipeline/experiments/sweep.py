"""The folder of an experiment: many small keyed jobs, each one table, made once and reused while their key stays.

What `perturb` and `ablate` share: the folder's lock and record, which results are there, the fan-out, and what
happens when a job fails, a worker dies or the user interrupts. Leaves to others: which jobs there are and what they
compute (`perturb`, `ablate`), the scans that they work on (`sources`).
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import pyarrow as pa

from ...schemas.errors import FidpipeError
from ...schemas.settings import Settings, to_toml
from ..engine.cluster import start_pool
from ..engine.plan import library_versions
from ..engine.pool import Pool, WorkerDied
from ..engine.progress import Reporter
from ..engine.task import Failure, Report
from ..run import STAGES, check_folder
from ..storage.ledger import JobName, JobRecord
from ..storage.record import LIBRARIES, RUN_JSON, SETTINGS_TOML, dumps, read_run, run_header, what_changed
from ..storage.store import Store, TableFolder
from .ticker import Ticker


@dataclass(frozen=True, kw_only=True)
class SweepOutcome:
    """What has become of an experiment, whichever it is.

    failures : why a job, a pair or a scan failed, by name
    n_made, n_reused : jobs
    """

    folder: Path
    failures: dict[str, str]
    n_made: int
    n_reused: int
    wall_s: float


@dataclass(frozen=True)
class Part:
    """One table of an experiment: its name in the folder, its key, and what makes it.

    table, pair_id, part : folder, pair, and what of the pair ("dropout-0.4"; only characters that are safe in a name)
    make, args : a function of a module and its arguments (paths, keys and numbers); gives the rows
    cost_s : roughly what it costs; orders the work and guesses the time left, nothing else
    """

    table: str
    pair_id: str
    part: str
    key: str
    make: Callable[..., pa.Table]
    args: tuple[Any, ...]
    cost_s: float = 1.0

    @property
    def name(self) -> JobName:
        """What the job is called in the index."""
        return self.table, self.pair_id, self.part


@dataclass(frozen=True)
class Call:
    """A task for the pool: a function that gives a `Report`."""

    name: str
    function: Callable[..., Report]
    args: tuple[Any, ...]
    cost_s: float


def make_part(part: Part, folder: Path, token: str) -> Report:
    """Makes and writes one table; a failure is reported, not raised."""
    start = perf_counter()
    try:
        rows = part.make(*part.args)
    except FidpipeError as error:
        return Report(part.pair_id, failure=Failure(part.table, part.part, str(error)))
    except MemoryError as error:
        return Report(part.pair_id, failure=Failure(part.table, part.part, f"out of memory ({error})"))
    except Exception as error:  # one broken job does not stop the others
        trace = "".join(traceback.format_exception(error))
        reason = f"internal error: {type(error).__name__}: {error}"
        return Report(part.pair_id, failure=Failure(part.table, part.part, reason, trace))
    tables = TableFolder(folder, token)
    name, stored = tables.write(part.table, rows, part.key, part.pair_id, part.part)
    steps = (("all", perf_counter() - start),)
    record = JobRecord(part.table, part.pair_id, part.part, part.key, {name: stored}, {}, steps)
    tables.note_job(record)
    return Report(part.pair_id, (record,))


class Sweep:
    """An experiment's folder while it is worked on; `sweeping` opens one."""

    def __init__(
        self,
        out: Path,
        workers: int | None,
        scheduler: str | None,
        memory_gib: float | None,
        store: Store,
        reporter: Reporter,
    ) -> None:
        self.out = out
        self.store = store
        self.reporter = reporter
        self.changes: list[str] = []
        self.failures: dict[str, str] = {}
        self.n_made = self.n_reused = 0
        self._workers = workers
        self._scheduler = scheduler
        self._memory_gib = memory_gib
        self._pool: Pool | None = None

    def run(self, parts: Iterable[Part], tables: Iterable[str]) -> None:
        """Makes the parts that are not there under their key; removes all else from the folders of these tables.

        Raises
        ------
        ValueError
            Two parts have one name: they would write one file. Nothing is removed or made.
        """
        parts, tables = list(parts), list(tables)
        twice = [name for name, n in Counter(part.name for part in parts).items() if n > 1]
        if twice:
            raise ValueError(f"part {' '.join(twice[0])} is there twice; each part of an experiment needs its own name")
        wanted = {part.name: part.key for part in parts}
        unwanted = []
        for record in self.store.records.values():
            if record.stage in tables and wanted.get(record.name) != record.key:
                unwanted.append(("out of date" if record.name in wanted else "not asked for", record))
            elif record.stage in tables and not self.store.is_whole(record):
                unwanted.append(("damaged or gone", record))
        self.forget(unwanted)
        for path in self.store.strays(tables):
            path.unlink()
        todo = [part for part in parts if part.name not in self.store.records]
        self.n_reused += len(parts) - len(todo)
        self.call(
            Call(f"{part.pair_id}, {part.part}", make_part, (part, self.out, self.store.token), part.cost_s)
            for part in todo
        )

    def forget(self, unwanted: Iterable[tuple[str, JobRecord]]) -> None:
        """Says what will be removed and why, and removes it."""
        unwanted = list(unwanted)
        for (reason, table), n in sorted(Counter((reason, record.stage) for reason, record in unwanted).items()):
            why = f"{reason} ({'; '.join(self.changes)})" if self.changes and reason == "out of date" else reason
            self.reporter.say(f"removing {n} result{'s' * (n > 1)} of {table}: {why}")
        for _, record in unwanted:
            self.store.forget(record)
        if unwanted:
            self.store.compact()

    def call(self, calls: Iterable[Call]) -> None:
        """Runs tasks, costly ones first; what a dying worker took with it is tried once more, one at a time."""
        calls = sorted(calls, key=lambda call: -call.cost_s)
        if not calls:
            return
        pool = self.pool
        with Ticker(self.reporter.console, len(calls), sum(call.cost_s for call in calls)) as ticker:
            waiting = {pool.submit(call.function, *call.args, priority=call.cost_s): call for call in calls}
            suspects = []
            while waiting:
                handle, outcome = pool.next_done()
                call = waiting.pop(handle)
                if isinstance(outcome, WorkerDied):
                    suspects.append(call)
                else:
                    self._take(call, outcome)
                    ticker.done(call.cost_s)
            for call in suspects:
                pool.submit(call.function, *call.args)
                _, outcome = pool.next_done()
                if isinstance(outcome, WorkerDied):
                    self.fail(call.name, f"its worker process died twice ({outcome.detail}); is memory short?")
                else:
                    self._take(call, outcome)
                ticker.done(call.cost_s)
        self.store.compact()

    def fail(self, name: str, reason: str) -> None:
        """A job or a scan that came to nothing."""
        self.failures[name] = reason
        self.reporter.fail(name, reason)

    def record(self, facts: dict[str, Any]) -> None:
        """Writes `run.json`."""
        self.store.replace(self.out / RUN_JSON, dumps(facts))

    @property
    def pool(self) -> Pool:
        """Where tasks run; started when first needed."""
        if self._pool is None:
            self._pool = start_pool(
                self._workers,
                self._scheduler,
                self._memory_gib,
                self.store.token_path,
                library_versions(LIBRARIES),
            )
        return self._pool

    def close(self) -> None:
        """Ends the pool, whatever it is doing."""
        if self._pool is not None:
            self._pool.close(now=True)

    def _take(self, call: Call, report: Report) -> None:
        for record in report.records:
            self.store.take(record)
            self.n_made += 1
        if report.failure is not None:
            self.fail(call.name, report.failure.reason)
            if report.failure.trace:
                self.reporter.say(report.failure.trace)


@contextmanager
def sweeping(
    experiment: str,
    source: Path,
    out: Path,
    settings: Settings,
    workers: int | None,
    scheduler: str | None,
    reporter: Reporter,
) -> Iterator[Sweep]:
    """The folder of an experiment, locked, with the head of its record written.

    Raises
    ------
    RunError
        The folder holds something else, or is in use.
    """
    check_folder(out, source, experiment)
    store = Store(out)
    with store.locked():
        sweep = Sweep(out, workers, scheduler, settings.machine.memory_gib, store, reporter)
        sweep.changes = what_changed(read_run(out), settings, STAGES)
        sweep.record({"experiment": experiment, **run_header(source, settings, STAGES)})
        store.replace(out / SETTINGS_TOML, to_toml(settings).encode())
        try:
            yield sweep
        finally:
            sweep.close()
