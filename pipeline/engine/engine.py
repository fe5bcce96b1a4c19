"""The jobs of a run on workers, what workers need to know, and the announcement of large pairs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain

from ...schemas.errors import FidpipeError
from ...schemas.settings import InputSettings, Settings
from ...stages.arrays import transform_of
from ...stages.clean import clean_scan
from ...stages.thinning import smallest_voxel
from ..datasets.content import ScanContent
from ..datasets.pairs import ScanPair, may_crash
from ..datasets.readers import read_scan
from ..stage import Stage
from . import costs
from .plan import PairPlan, with_results
from .pool import Pool
from .schedule import Collector, Schedule
from .survey import PlanPair
from .time_limit import NOTES, TimeLimit

_LARGE_PAIR = 500_000  # points of both files


@dataclass(frozen=True)
class Machines:
    """Machines that do the work; no result depends on them.

    workers : processes on this machine; None for one per core; 1 for this process alone, unless a
        job may end it
    scheduler : address of a dask scheduler, instead of a cluster on this machine
    pair_timeout_s : a pair that takes workers longer than this fails; None for no limit
    """

    workers: int | None = None
    scheduler: str | None = None
    pair_timeout_s: float | None = None


@contextmanager
def started_schedule(
    todo: Sequence[ScanPair],
    n_jobs: int,
    plan_pair: PlanPair,
    collector: Collector,
    stages: Sequence[Stage],
    settings: Settings,
    machines: Machines,
) -> Iterator[Schedule]:
    """Context with the schedule of jobs, whose workers end with it, even if tasks are running.

    Without pairs there are no workers; a reader that may end its process never runs in the
    command's own.

    Parameters
    ----------
    todo : pairs that have jobs to do
    n_jobs : number of these jobs
    plan_pair : returns the plan of a pair
    collector : receives the results
    stages : all stages whose jobs may be planned
    """
    tables = collector.folder.for_workers(share_disk=machines.scheduler is None)
    pool = Pool()
    if todo:
        from .cluster import Requirements, code_versions, start_pool

        required = None
        if machines.scheduler:
            libraries = chain.from_iterable(stage.libraries for stage in stages)
            required = Requirements(code_versions(libraries), tables)
            tables.put_token()
        is_risky = required is None and may_crash(todo)
        pool = start_pool(
            machines.workers,
            settings.machine.memory_gib,
            {stage.make.__module__ for stage in stages},
            may_end_workers=machines.pair_timeout_s is not None or is_risky,
            address=machines.scheduler,
            required=required,
        )

    def plans() -> Iterator[PairPlan]:
        for i, pair in enumerate(todo):
            limit = None
            if machines.pair_timeout_s is not None:
                notes = collector.folder.folder / NOTES / str(i)
                limit = TimeLimit(machines.pair_timeout_s, notes)
            plan, _ = with_results(plan_pair(pair), collector.folder)
            yield replace(plan, tables=tables, limit=limit)

    try:
        yield Schedule(pool, plans(), len(todo), n_jobs, collector)
    finally:
        pool.close()


def large_pairs_warnings(
    pairs: Sequence[ScanPair],
    contents: Mapping[str, Mapping[str, ScanContent]],
    settings: InputSettings,
) -> list[str]:
    """The warning of pairs beyond the points of usual sensors, if there are any.

    Parameters
    ----------
    contents : of their files, by pair_id and side
    """
    n_points = []
    for pair in pairs:
        files = contents[pair.pair_id].values()
        n_points.append(sum(content.approximate_points for content in files))
    n_most = max(n_points, default=0)
    if settings.voxel_m is not None or n_most < _LARGE_PAIR:
        return []
    largest = pairs[n_points.index(n_most)]
    return [large_pairs_text(n_points, voxel_for(largest, settings))]


def large_pairs_text(n_points: Sequence[int], voxel_m: float | None) -> str:
    """Memory and time of pairs beyond the points of usual sensors, of which there are some, and how to reduce them.

    Parameters
    ----------
    n_points : of both files of each pair
    voxel_m : see `voxel_for`
    """
    n_large = sum(n >= _LARGE_PAIR for n in n_points)
    n_most = max(n_points)
    value = "" if voxel_m is None else f"={voxel_m:g}"
    return (
        f"{n_large} of {len(n_points)} pairs have {_LARGE_PAIR:,} points or more; "
        f"the largest has about {n_most:,}; with all of them it takes some "
        f"{costs.pair_bytes(n_most) / 2**30:.0f} GiB of memory and "
        f"{costs.pair_seconds(n_most) / 60:.0f} minutes, more where points are dense; "
        f"thin both sides alike with input.voxel_m{value}, lower graph.tau_m, or leave out points "
        "with input.max_range_m or input.include_box"
    )


def voxel_for(pair: ScanPair, settings: InputSettings) -> float | None:
    """Value of `input.voxel_m` with which a pair is not large; None if none is proposed, or a scan cannot be read."""
    if may_crash([pair]):
        return None
    voxels_m = []
    for side, ref in pair.scans.items():
        try:
            scan = read_scan(ref, settings.columns_of(side))
        except FidpipeError:
            return None  # its job names the fault
        T_real_sim = transform_of(pair.motion(side))
        frame = settings.frame_of(side)
        points = clean_scan(scan.points, settings, frame=frame, T_real_sim=T_real_sim).points
        voxel_m = smallest_voxel(points, lambda points: len(points) < _LARGE_PAIR // 2)
        if voxel_m is None:
            return None
        voxels_m.append(voxel_m)
    return max(voxels_m)
