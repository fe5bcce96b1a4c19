"""Where a run stands: which results are wanted, which of them are there, and which that are there are not wanted.

Only names and hashes are kept; a pair is planned anew whenever its jobs are asked for. Leaves to others: keys (`plan`),
what the files hold (`inspection`), what is done about it (`session`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from ...schemas.columns import SIDES
from ..datasets.pairs import Dataset, ScanPair
from ..datasets.scan_checks import ScanContent
from ..storage.ledger import JobName, JobRecord
from ..storage.store import Store
from .plan import Stage, plan_pair, with_whole_results
from .request import RunRequest
from .task import PairTask


class Standing:
    """Where a run stands.

    Parameters
    ----------
    selected : names of the pairs that are to be worked on
    failures : why a pair failed in this run, by pair_id; grows while it works

    Attributes
    ----------
    contents : what the files of each pair hold, by pair_id and side; of pairs whose files can all be read
    todo : selected pairs with jobs to be made
    n_stored : of these pairs, how many jobs of each stage are done
    unwanted : why a result that is there is not wanted, by job
    """

    def __init__(
        self,
        request: RunRequest,
        stages: tuple[Stage, ...],
        dataset: Dataset,
        selected: set[str],
        store: Store,
        failures: Mapping[str, str],
    ) -> None:
        self.stages = stages
        self.stage_names = tuple(stage.name for stage in stages)
        self.contents: dict[str, dict[str, ScanContent]] = {}
        self.todo: list[ScanPair] = []
        self.n_stored = Counter[str]()
        self.unwanted: dict[JobName, str] = {}
        self._request, self._dataset, self._selected = request, dataset, selected
        self._store, self._failures = store, failures
        self._usable: dict[str, ScanPair] = {}
        self._redo = frozenset[str]()
        if request.from_stage:
            self._redo = frozenset(self.stage_names[self.stage_names.index(request.from_stage) :])

    def compare(self) -> None:
        """Compares what is there with what is wanted, once the files are known."""
        for pair in self._dataset.pairs:
            if pair.pair_id not in self.contents or pair.pair_id in self._failures:
                continue
            self._usable[pair.pair_id] = pair
            names, n_stored = self._names(pair.pair_id), Counter[str]()
            if any(name in self._store.records for name in names):
                task, unwanted = self._planned(pair)
                self.unwanted |= unwanted
                n_stored = Counter(job.stage for job in task.jobs if job.stored)
            if pair.pair_id in self._selected and n_stored.total() < len(names):
                self.todo.append(pair)
                self.n_stored += n_stored
        dataset_ids = {pair.pair_id for pair in self._dataset.pairs}
        for name in self._store.records:
            stage, pair_id, _ = name
            if not pair_id:
                continue  # a table of the whole run
            if pair_id not in dataset_ids:
                self.unwanted[name] = "no longer in the dataset"
            elif pair_id in self._failures:
                self.unwanted[name] = "the input cannot be used"
            elif stage not in self.stage_names and not self._still_holds(name):
                self.unwanted[name] = "out of date"

    def task(self, pair_id: str) -> PairTask | None:
        """The jobs of a pair, those done and those not; None if its files cannot be used."""
        return self._planned(self._usable[pair_id])[0] if pair_id in self._usable else None

    def tasks(self) -> Iterator[PairTask]:
        """Those of the pairs with jobs to be made, each planned when it is asked for."""
        return (self._planned(pair)[0] for pair in self.todo)

    def names(self) -> Iterator[JobName]:
        """The finished jobs whose results are as wanted."""
        return (name for pair_id in self._usable for name in self._names(pair_id) if self._is_current(name))

    def records(self, stage: str | None = None) -> Iterator[JobRecord]:
        """Their records; of all stages, or of one."""
        return (self._store.records[name] for name in self.names() if stage in (None, name[0]))

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows of `pairs`: every pair with current results, and every pair that failed, now or before."""
        extras = {stage.name for stage in self.stages if stage.is_wanted}
        for pair_id in self._usable:
            names = [name for name in self._names(pair_id) if name[0] not in extras]
            if all(self._is_current(name) for name in names):
                yield self._store.records[names[-1]].facts["row"]
            elif pair_id in self._failures:
                yield _failed_row(pair_id, self._failures[pair_id])
            elif reason := self._past_failure(pair_id):
                yield _failed_row(pair_id, reason)
        for pair_id in self._failures.keys() - self._usable.keys():
            yield _failed_row(pair_id, self._failures[pair_id])

    def _past_failure(self, pair_id: str) -> str | None:
        """Why a pair failed in an earlier run, if the same job would fail again."""
        past = self._store.failures.get(pair_id)
        task = self.task(pair_id) if past else None
        if past and task and any(past["key"] == job.key for job in task.jobs if not job.stored):
            return str(past["reason"])
        return None

    def _names(self, pair_id: str) -> list[JobName]:
        """What the jobs of a pair are called, in their order."""
        return [(stage.name, pair_id, side) for stage in self.stages for side in stage.sides]

    def _is_current(self, name: JobName) -> bool:
        return name in self._store.records and name not in self.unwanted

    def _planned(self, pair: ScanPair) -> tuple[PairTask, dict[JobName, str]]:
        """The jobs of a pair with their wanted keys, and why results that are there are not those."""
        contents, label_names = self.contents[pair.pair_id], self._dataset.label_names
        task = replace(
            plan_pair(
                self.stages, pair, {side: contents[side].key(label_names) for side in SIDES}, self._request.settings
            ),
            label_names=label_names,
            input_hashes={side: of.sha256 for side, of in contents.items()},
            folder=self._request.out,
            token=self._store.token,
        )
        return with_whole_results(task, self._store, self._redo if pair.pair_id in self._selected else frozenset())

    def _still_holds(self, name: JobName) -> bool:
        """Whether the result of an extra that is not asked for this time is of the current results."""
        task = self.task(name[1])
        return task is not None and self._store.records[name].facts.get("made_from") in {job.key for job in task.jobs}


def _failed_row(pair_id: str, reason: str) -> dict[str, Any]:
    return {"pair_id": pair_id, "status": "failed", "reason": reason}
