"""Diagnosis of a finished run: the gain of correcting each cause that it names, as jobs of the engine."""

from __future__ import annotations

from pathlib import Path

from ...schemas.errors import RunError
from ...schemas.results import Diagnosis
from ...schemas.settings import parse
from ..datasets.pairs import ScanPair
from ..engine.engine import Machines, started_schedule
from ..engine.plan import OUT_OF_DATE, PairPlan, plan_jobs, plan_on_results
from ..engine.progress import Reporter
from ..engine.schedule import Collector
from ..engine.survey import PlanPair, remove_stale
from ..jobs import stages_under
from ..jobs.gains_job import gains_stage
from ..results.diagnosis import diagnosis_of
from ..results.finished import FinishedRun
from ..stage import Stage
from ..storage.table_files import JobName
from .latency import latency_note


def diagnose_run(
    folder: Path, reporter: Reporter, machines: Machines | None = None
) -> Diagnosis:
    """Measure the gain of correcting each cause of a finished run; gains that are up to date are reused.

    Raises
    ------
    RunError
        The folder is not a finished run, no pair is scored, a table is damaged, or some pairs cannot be diagnosed.
    KeyboardInterrupt
        As it came; the same command resumes.
    """
    machines = machines or Machines()
    run = FinishedRun(folder.absolute() if machines.scheduler else folder)
    overview = run.record.overview
    if overview is None:
        raise RunError(f"run {folder}: no pair is scored; fidpipe status {folder} says why")
    settings = parse(run.record.settings)
    stage = gains_stage({cause.name: cause.estimate for cause in overview.causes})
    jobs = plan_jobs((*stages_under(settings), stage), settings)

    def plan_pair(pair: ScanPair) -> PairPlan:
        """The job that measures the gains of a pair, with its other results as they are."""
        return plan_on_results(jobs, pair, run.store.finished_jobs(pair.pair_id), stage)

    with run.store.locked():
        todo, stale = _survey(run, plan_pair, stage)
        collector = Collector(run.store, reporter)
        with started_schedule(
            todo, len(todo), plan_pair, collector, (stage,), settings, machines
        ) as schedule:
            remove_stale(stale, run.store, reporter, ["the causes changed"])
            schedule.run()
    if collector.failures:
        raise RunError(
            f"run {folder}: pairs that cannot be diagnosed: {', '.join(collector.failures)}"
        )
    diagnosis = diagnosis_of(run.store, run.record, run.names)
    if diagnosis is None:
        raise RunError(
            f"run {folder}: the run changed while it was diagnosed; diagnose it again"
        )
    note = latency_note(run, diagnosis.causes)
    return diagnosis.model_copy(update={"notes": (note,)}) if note else diagnosis


def _survey(
    run: FinishedRun, plan_pair: PlanPair, stage: Stage
) -> tuple[list[ScanPair], dict[JobName, str]]:
    """The pairs whose gains are missing, and gains of other amounts with the reason why they are stale."""
    todo = []
    stale = {}
    for row in run.scored:
        pair = ScanPair(row["pair_id"], None, None)
        record = run.store.ledger.jobs(pair.pair_id).get((stage.name, ""))
        if record is None:
            todo.append(pair)
        elif record.key != plan_pair(pair).keys[record.job] or run.store.damaged_files(record):
            todo.append(pair)
            stale[record.name] = OUT_OF_DATE
    return todo, stale
