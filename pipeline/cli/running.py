"""The commands around a run: settings, check, run, best-case and status."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..builds import dataset_and_run
from .options import (
    EXIT_WRONG_INPUT,
    AsJson,
    Assignments,
    DatasetFolder,
    Pairs,
    PairTimeout,
    Preset,
    Replace,
    RunFolder,
    Scheduler,
    Seed,
    SettingsFile,
    SimFolder,
    Workers,
    machines_of,
)
from .output import print_json, print_outcome, print_text, print_view

if TYPE_CHECKING:
    from ...schemas.settings import Settings


def settings(
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    json_schema: bool = False,
) -> None:
    """Print all settings as a commented TOML file, to edit and pass to --settings.

    Each comes with its meaning and allowed values. Without options, the values are the defaults.

    Parameters
    ----------
    json_schema : The JSON schema of such files, for editors and other programs.

    Examples
    --------
    fidpipe settings > settings.toml             then: fidpipe run dataset/ --settings settings.toml

    fidpipe settings --preset reference

    fidpipe settings --settings runs/dataset/settings.toml    those of a run, with comments

    fidpipe settings --json-schema > fidpipe.schema.json    for an editor: docs/settings.md
    """
    from ...schemas import settings_text
    from ...schemas.settings import load

    if json_schema and (preset or settings or assignments):
        raise typer.BadParameter(
            "--json-schema does not depend on other options; give it alone"
        )
    if json_schema:
        print_json(settings_text.json_schema())
    else:
        print_text(
            settings_text.commented_toml(load(settings, assignments or [], preset=preset))
        )


def check(
    dataset: DatasetFolder,
    sim: SimFolder = None,
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Show what a run would read from a dataset, and what is wrong with it.

    Lengths are metres, angles degrees; scans have x forward, y left, z up unless input.real_frame
    or input.sim_frame says otherwise. Exits with 1 if there is an error; warnings alone exit with
    0.

    Examples
    --------
    fidpipe check dataset/ --set input.min_range_m=3

    fidpipe check dataset/ --set input.real_frame=nuscenes --set input.sim_frame=carla

    fidpipe check dataset/ --json | jq -r '.faults[]'
    """
    from ...schemas.settings import load, overrides, preset_of
    from ..inspect.check_view import check_json, check_view
    from ..inspect.scan_checks import check_dataset
    from ..storage.run_record import as_options

    if preset is None and settings is None:
        preset = "reference"
    in_force = load(settings, assignments or [], preset=preset)
    folders = [str(dataset)] if sim is None else [str(dataset), str(sim)]
    options = as_options(preset_of(in_force), overrides(in_force))
    dataset, _ = dataset_and_run(dataset, sim, None)
    result = check_dataset(dataset, in_force)
    if as_json:
        print_json(check_json(result))
    else:
        print_view(check_view(result, shlex.join(["fidpipe", "run", *folders, *options])))
    raise typer.Exit(EXIT_WRONG_INPUT if result.faults or result.doubts else 0)


def run(
    dataset: DatasetFolder,
    sim: SimFolder = None,
    out: Path | None = None,
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    pair_timeout: PairTimeout = None,
    from_stage: Annotated[str | None, typer.Option("--from", metavar="STAGE")] = None,
    pairs: Pairs = None,
    seeds: Annotated[int | None, typer.Option(min=1, metavar="N")] = None,
    tasks: bool = False,
    replace: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Evaluate a dataset, stage by stage; run again to resume.

    Up-to-date results are reused. To replace the results of a finished run with those of other
    settings, use --replace or another --out. The summary has the share of the surface that is
    simulated, missing and invented pieces, what to fix first, the worst places and the object
    scores. Exits with 0 if all pairs are scored, 3 if some failed.

    Parameters
    ----------
    out : Folder of the run, else runs/NAME.
    from_stage : Recompute this stage and all later stages.
    seeds : Number of seeds for which communities to metrics are repeated, to see how stable the
        scores are.
    tasks : Also what a perception stack gets from both scans: obstacles, ground, occupancy, free
        space.

    Examples
    --------
    fidpipe run dataset/                         results go to runs/dataset

    fidpipe run drive/ build42/lidar/            real and simulated scans, paired by name or time

    fidpipe run dataset/ --set matching.delta_m=3 --out runs/delta3

    fidpipe run dataset/ --set matching.delta_m=3 --replace    matching and later stages only

    fidpipe run dataset/ --from metrics --pairs '0001*' --workers 8

    fidpipe run dataset/ --preset reference --out runs/dataset-reference    for comparing simulators

    fidpipe run dataset/ --set metrics.baselines=chamfer,emd    also baseline metrics, or "all"

    fidpipe run dataset/ --tasks                 obstacles lost and added, free space, ...

    fidpipe run dataset/ --json | jq '.record.overview.causes'    progress goes to standard error

    fidpipe run dataset/ --scheduler tcp://host:8786    on a cluster: docs/cluster.md

    fidpipe run dataset/ --pair-timeout 600      a pair that takes more than 10 minutes fails
    """
    from ...schemas.settings import load
    from ..engine import prefork

    in_force = load(settings, _all_assignments(assignments, seeds, tasks=tasks), preset=preset)
    dataset, out = dataset_and_run(dataset, sim, out)
    if scheduler is None and workers != 1 and dataset.is_dir() and not out.exists():
        # a new run needs workers as soon as all else is imported
        prefork.start(["fidpipe.pipeline.jobs"])

    from ..engine.progress import Reporter
    from ..report.views.run_view import outcome_values, outcome_view
    from ..run import run_dataset

    outcome = run_dataset(
        dataset,
        out,
        in_force,
        Reporter(),
        from_stage=_known_stage(from_stage, in_force),
        pattern=pairs,
        machines=machines_of(workers, scheduler, pair_timeout),
        replace=replace,
    )
    print_outcome(
        outcome_values(outcome) if as_json else outcome_view(outcome), outcome.failures
    )


def _all_assignments(given: list[str] | None, seeds: int | None, *, tasks: bool) -> list[str]:
    """The assignments of a command, and those that --seeds and --tasks stand for."""
    assignments = list(given or [])
    if seeds is not None:
        assignments.append(f"stability.seeds={seeds}")
    if tasks:
        assignments.append("tasks.names=all")
    return assignments


def _known_stage(name: str | None, settings: Settings) -> str | None:
    from ..jobs import stages_under

    names = [stage.name for stage in stages_under(settings)]
    if name is not None and name not in names:
        raise typer.BadParameter(
            f"expected one of {', '.join(names)}; got {name!r}", param_hint="--from"
        )
    return name


def best_case(
    source: Annotated[
        Path, typer.Argument(metavar="RUN | DATASET", help="Folder of a run, or of a dataset.")
    ],
    out: Path | None = None,
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    noise_m: Annotated[float | None, typer.Option(min=0, max=10, metavar="M")] = None,
    dropout: Annotated[float | None, typer.Option(min=0, max=0.99, metavar="SHARE")] = None,
    seed: Seed = 0,
    pairs: Pairs = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    pair_timeout: PairTimeout = None,
    replace: Replace = False,
) -> None:
    """Evaluate a perfect simulator: each real scan against a second measurement of itself.

    The result is a run with the same settings, which show, report, gate and compare take as
    --best-case. The second measurement is the scan with range noise and losses, by default those
    that it shows (else 3 cm and 3 %). Of a dataset without a run, give the
    settings of the run that it is for. How to read it: docs/fidelity.md.

    Parameters
    ----------
    out : Folder of the run, else runs/NAME-best-case.
    noise_m : Noise (m), else as measured.
    dropout : Lost share, else as measured.
    seed : Seed of noise and losses.

    Examples
    --------
    fidpipe best-case runs/dataset                   results go to runs/dataset-best-case

    fidpipe show runs/dataset --best-case runs/dataset-best-case
    """
    dataset, in_force = _dataset_of(source, preset, settings, assignments)
    folder = Path("runs") if dataset == source else source.parent

    from ..engine.progress import Reporter
    from ..generate.best_case_run import run_best_case
    from ..report.views.run_view import outcome_view

    outcome = run_best_case(
        dataset,
        out or folder / f"{source.resolve().name or 'dataset'}-best-case",
        in_force,
        Reporter(),
        noise_m=noise_m,
        lost_share=dropout,
        seed=seed,
        pattern=pairs,
        machines=machines_of(workers, scheduler, pair_timeout),
        replace=replace,
    )
    print_outcome(outcome_view(outcome), outcome.failures)


def _dataset_of(
    source: Path, preset: str | None, settings: Path | None, assignments: list[str] | None
) -> tuple[Path, Settings]:
    """The dataset of a run with the settings of the run; a dataset with those that are given."""
    from ...schemas.settings import load
    from ..storage.files import path_exists

    if not path_exists(source / "run.json"):
        return source, load(settings, assignments or [], preset=preset)
    if preset or settings or assignments:
        raise typer.BadParameter(
            "a run has its settings; leave out --preset, --settings and --set"
        )

    from ..results.finished import FinishedRun
    from ..storage.run_record import SETTINGS_TOML
    from ..storage.urls import recorded_path

    return recorded_path(FinishedRun(source).record.dataset), load(source / SETTINGS_TOML)


def status(run: RunFolder) -> None:
    """Show the progress of a run: pairs done, stale, failed and to do, by stage; damaged tables.

    Examples
    --------
    fidpipe status runs/dataset
    """
    from ..report.views.status_view import status_view
    from ..results.status import run_status

    print_view(status_view(run_status(run)))
