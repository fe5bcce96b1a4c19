"""What comes of the jobs while they run: results in the ledger, failures by pair, progress."""

from __future__ import annotations

from collections.abc import Iterable
from shutil import rmtree

from ..storage.folder import RunFolder
from .plan import PairPlan
from .progress import Reporter
from .worker import BatchResult, JobFailure, failure_text


class Collector:
    """Collects the results of jobs of one folder.

    Parameters
    ----------
    folder : of the run, locked
    reporter : shows progress

    Attributes
    ----------
    failures : reasons by pair_id
    n_made : jobs that were done
    """

    def __init__(self, folder: RunFolder, reporter: Reporter) -> None:
        self.folder = folder
        self.reporter = reporter
        self.failures: dict[str, str] = {}
        self.n_made = 0
        self._traces: set[str] = set()

    def fail(self, pair_id: str, key: str, reason: str) -> None:
        """Record and report the failure of a pair.

        Parameters
        ----------
        key : of the job that failed; "" if the input cannot be used
        """
        self.failures[pair_id] = reason
        self.folder.ledger.put_failure(pair_id, key, reason)
        self.reporter.fail(f"pair {pair_id}", reason)

    def batch_done(self, result: BatchResult) -> None:
        """Add the finished jobs of a pair to the ledger; others of its batch may have failed."""
        if result.records:
            self.folder.ledger.put_jobs(result.pair_id, result.records)
        self.n_made += len(result.records)
        self.reporter.advance(len(result.records))

    def objects_done(self, plan: PairPlan, n_done: int) -> None:
        """Show that some objects of a pair are scored; their jobs are finished with the last ones."""
        n_objects = len(plan.objects or [])
        self.reporter.advance(0, objects=f"; {plan.pair_id}: {n_done} of {n_objects} objects")

    def pair_done(self, plan: PairPlan, failures: Iterable[JobFailure]) -> None:
        """Report the failures of a pair that has ended.

        The ledger keeps the reason of a failed pair; all results of a pair without scores are
        removed.
        """
        order = list(plan.jobs)
        failures = sorted(failures, key=lambda failure: order.index(failure.job))
        self.reporter.advance(len(plan.todo), 1)
        if plan.limit is not None:
            rmtree(plan.limit.folder, ignore_errors=True)
        required = [failure for failure in failures if not plan.jobs[failure.job].stage.is_extra]
        if required:
            for record in self.folder.forget(plan.pair_id):
                self.n_made -= record.made_by == self.folder.token
        # which of the others were begun depends on the number of workers
        reported = required[:1] or failures
        if reported:
            self.fail(plan.pair_id, plan.keys[reported[0].job], failure_text(reported))
        else:
            self.folder.ledger.drop_failure(plan.pair_id)
        for failure in failures:
            if failure.trace and failure.trace not in self._traces:
                self._traces.add(failure.trace)
                self.reporter.say(failure.trace)
