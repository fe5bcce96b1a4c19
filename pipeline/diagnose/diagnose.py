"""Diagnosis of a finished run: the gain of correcting each cause that it names, as jobs of the engine."""

from __future__ import annotations

from pathlib import Path

from ...schemas.errors import RunError
from ...schemas.results import Diagnosis
from ...schemas.settings import Settings, parse
from ..datasets.pairs import ScanPair
from ..engine.engine import Machines, RunEngine, Survey
from ..engine.plan import PairPlan, Planner
from ..engine.progress import Reporter
from ..jobs import stages_under
from ..jobs.gains_job import gains_stage
from ..results.diagnosis import diagnosis_of
from ..results.finished import FinishedRun
from ..stage import Stage
from .latency import latency_note


def diagnose_run(folder: Path, reporter: Reporter, machines: Machines | None = None) -> Diagnosis:
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
    groups = {name: values for name, values in run.record.settings.items() if name in Settings.model_fields}
    settings = parse(groups)
    stage = gains_stage({cause.name: cause.estimate for cause in overview.causes})
    with run.store.locked(), RunEngine(run.store, settings, machines, reporter, (stage,)) as engine:
        planner = Planner((*stages_under(settings), stage), settings, {})
        survey = _survey(run, engine, planner, stage)
        with engine.making(
            survey, lambda pair: _plan(run, planner, stage, pair), lambda: None, ["the causes changed"]
        ) as schedule:
            schedule.run()
        if engine.failures:
            reasons = "; ".join(f"pair {name}: {reason}" for name, reason in engine.failures.items())
            raise RunError(f"run {folder}: {reasons}")
    diagnosis = diagnosis_of(run.store, run.record, [row["pair_id"] for row in run.scored])
    if diagnosis is None:
        raise RunError(f"run {folder}: the run changed while it was diagnosed; diagnose it again")
    note = latency_note(run, diagnosis.causes)
    return diagnosis.model_copy(update={"notes": (note,)}) if note else diagnosis


def _plan(run: FinishedRun, planner: Planner, stage: Stage, pair: ScanPair) -> PairPlan:
    """The job that measures the gains of a pair, with the other results of the pair as they are."""
    return planner.plan_on_results(pair, run.store.ledger.jobs(pair.pair_id), stage)


def _survey(run: FinishedRun, engine: RunEngine, planner: Planner, stage: Stage) -> Survey:
    """The pairs whose gains are missing, and gains of other amounts."""
    survey = Survey()
    for row in run.scored:
        pair = ScanPair(row["pair_id"], None, None)
        engine.contents[pair.pair_id] = {}
        survey.usable.append(pair)
        key = _plan(run, planner, stage, pair).keys[stage.name, ""]
        record = run.store.ledger.jobs(pair.pair_id).get((stage.name, ""))
        if record is not None and record.key == key and not run.store.damaged_files(record):
            continue
        survey.todo.append(pair)
        survey.n_jobs += 1
        if record is not None:
            survey.stale[record.name] = "out of date"
    return survey
