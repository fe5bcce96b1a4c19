"""What travels to a worker and back: the jobs of a pair with their keys and paths, and what became of them. No points.

Leaves to others: what a job does (`jobs`), where the tables lie (`store`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from ...schemas.settings import Settings
from ..datasets.pairs import ScanPair
from ..storage.ledger import JobRecord, StoredFile

if TYPE_CHECKING:
    from .workbench import Workbench

Facts = dict[str, Any]
Tables = dict[str, pa.Table]


@dataclass(frozen=True)
class Job:
    """One stage of one pair (and side), its key, and where its result is if there is one.

    gives : the tables that it makes
    make : the function below that makes them
    stored, facts : of a result that is there already
    """

    stage: str
    side: str
    key: str
    gives: tuple[str, ...]
    make: Callable[[Workbench, str], tuple[Tables, Facts]]
    stored: Mapping[str, StoredFile] | None = None
    facts: Facts = field(default_factory=dict)


@dataclass(frozen=True)
class PairTask:
    """What a worker needs to know of a pair: paths and keys, no points.

    jobs : all jobs of the pair in their order; those without `stored` can be made
    input_hashes : content hash of each scan file, by side
    """

    pair: ScanPair
    settings: Settings
    jobs: tuple[Job, ...]
    label_names: Mapping[int, str] = field(default_factory=dict)
    input_hashes: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    token: str = ""

    def with_records(self, records: Iterable[JobRecord]) -> PairTask:
        """The same task, knowing that these jobs are done."""
        done = {(record.stage, record.side): record for record in records}
        jobs = []
        for job in self.jobs:
            record = done.get((job.stage, job.side))
            jobs.append(job if record is None else replace(job, stored=record.files, facts=record.facts))
        return replace(self, jobs=tuple(jobs))


@dataclass(frozen=True)
class Failure:
    """Why a pair cannot be scored; `trace` where the fault is ours."""

    stage: str
    side: str
    reason: str
    trace: str = ""


@dataclass(frozen=True)
class Report:
    """What a task has done: the jobs that are finished, and the failure that stopped it."""

    pair_id: str
    records: tuple[JobRecord, ...] = ()
    failure: Failure | None = None


@dataclass(frozen=True)
class ObjectScores:
    """Rows of `selection` and `metrics` of some objects of a pair, and the seconds of their steps."""

    selection: pa.Table
    metrics: pa.Table
    selection_steps: tuple[tuple[str, float], ...]
    metrics_steps: tuple[tuple[str, float], ...]
