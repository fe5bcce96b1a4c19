"""What has to be made: the wanted key of each job of a pair, and whether a whole result with that key is there.

Leaves to others: which stages there are (`run`), when and where jobs run (`schedule`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.settings import Settings
from ..datasets.pairs import ScanPair
from ..storage.ledger import JobName, JobRecord
from ..storage.store import Store, key_of
from .task import Facts, Job, PairTask, Tables
from .workbench import Workbench


@dataclass(frozen=True)
class Stage:
    """One row of the pipeline.

    takes, gives : names of tables; "scan" is the input file
    per_side : one job for each side, or one for the pair
    settings : groups of settings that the stage reads
    libraries : what it calls, besides numpy and scipy, under given settings
    version : of the stage's code, raised by hand whenever its results change
    make : the job
    is_wanted : for an extra of the pipeline, whether settings ask for it; None for a stage that every run has
    summarise : for an extra, what `run.json` holds of its finished jobs
    """

    name: str
    takes: tuple[str, ...]
    gives: tuple[str, ...]
    per_side: bool
    settings: tuple[str, ...]
    libraries: Callable[[Settings], tuple[str, ...]]
    version: int
    make: Callable[[Workbench, str], tuple[Tables, Facts]]
    is_wanted: Callable[[Settings], bool] | None = None
    summarise: Callable[[Iterable[JobRecord], Settings], Any] | None = None

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides of its jobs; "" for one job that takes both."""
        return SIDES if self.per_side else ("",)


def plan_pair(stages: Iterable[Stage], pair: ScanPair, inputs: Mapping[str, str], settings: Settings) -> PairTask:
    """The jobs of a pair with their wanted keys, none of them done yet.

    Parameters
    ----------
    stages : in their order
    pair : the pair
    inputs : by side, a hash of all that the side's scan is read from
    settings : in force
    """
    maker_of: dict[tuple[str, str], str] = {("scan", side): inputs[side] for side in SIDES}
    jobs: list[Job] = []
    for stage in stages:
        for side in stage.sides:
            read = [
                maker_of[table, of] for table in stage.takes for of in ([side] if side else _sides_of(maker_of, table))
            ]
            if stage.name == "ground" and side == "sim" and settings.ground.shared:
                read.append(jobs[0].key)
            key = key_of(
                stage.name,
                side,
                stage.version,
                {group: getattr(settings, group).model_dump(mode="json") for group in stage.settings},
                library_versions(("numpy", "scipy", *stage.libraries(settings))),
                pair.T_real_sim if stage.name == "ground" and side == "sim" else None,
                read,
            )
            jobs.append(Job(stage.name, side, key, stage.gives, stage.make))
            maker_of |= {(table, side): key for table in stage.gives}
    return PairTask(pair, settings, tuple(jobs))


def with_whole_results(
    task: PairTask, store: Store, redo: frozenset[str] = frozenset()
) -> tuple[PairTask, dict[JobName, str]]:
    """The task knowing which of its jobs are done, and the jobs in the index that are not wanted, each with the reason.

    Parameters
    ----------
    task : as planned
    store : the run
    redo : stages to be made again whatever their keys say
    """
    whole, unwanted = [], dict[JobName, str]()
    for job in task.jobs:
        record = store.records.get((job.stage, task.pair.pair_id, job.side))
        if record is None:
            continue
        if record.key != job.key:
            unwanted[record.name] = "out of date"
        elif not store.is_whole(record):
            unwanted[record.name] = "damaged or gone"
        elif job.stage in redo:
            unwanted[record.name] = "asked for by --from"
        else:
            whole.append(record)
    return task.with_records(whole), unwanted


def library_versions(names: Iterable[str]) -> dict[str, str]:
    """Installed versions by distribution name."""
    found = {}
    for name in names:
        if name not in _VERSIONS:
            _VERSIONS[name] = version(name)
        found[name] = _VERSIONS[name]
    return found


_VERSIONS: dict[str, str] = {}


def _sides_of(made: Mapping[tuple[str, str], Any], table: str) -> list[str]:
    return [side for name, side in made if name == table]
