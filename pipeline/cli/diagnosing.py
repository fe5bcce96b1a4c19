"""The commands that explain a difference and its effect: diagnose and tasks."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    AsJson,
    Assignments,
    RunFolder,
    Scheduler,
    Workers,
    machines_of,
)
from .output import print_json, print_view

if TYPE_CHECKING:
    from pydantic import JsonValue


def diagnose(
    sources: Annotated[list[Path], typer.Argument(metavar="RUN | REAL SIM")],
    workers: Workers = None,
    scheduler: Scheduler = None,
    since: Annotated[Path | None, typer.Option(metavar="RUN")] = None,
    tell_apart: bool = False,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Measure what fixing each cause of a run would gain, and what no cause explains.

    The gain of a cause is the share of the distance between the surfaces, beyond that of a second
    measurement, that disappears if the simulated points are corrected for it. run, show, report and
    compare then list causes by gain. An interrupted diagnosis resumes. With --since also what has
    changed from an earlier build, as compare shows it.

    With --tell-apart instead: a classifier learns to recognise simulated points by their
    neighbourhood (shape, roughness, spacing, rays, intensity) and is tested on other places. AUC
    0.5: it cannot; 1: it always can. Position has no influence. --set is for two folders.

    Parameters
    ----------
    sources : Folder of a run; with --tell-apart also two folders of scans (or recordings), which
        need no pairs.
    since : Run of an earlier build on the same real scans.
    tell_apart : Test if a classifier can distinguish real and simulated points.

    Examples
    --------
    fidpipe diagnose runs/dataset

    fidpipe diagnose runs/build42 --since runs/build41

    fidpipe diagnose runs/dataset --json | jq '.causes[0]'

    fidpipe diagnose runs/dataset --tell-apart

    fidpipe diagnose real/ sim/ --tell-apart --set input.sim_frame=carla
    """
    if tell_apart:
        if since:
            raise typer.BadParameter("--since is for causes; leave out --tell-apart")
        _tell_apart(sources, assignments, as_json=as_json)
        return
    if len(sources) > 1 or assignments:
        raise typer.BadParameter("expected one run and no option of --tell-apart")
    from ..diagnose.diagnose import diagnose_run
    from ..diagnose.diagnosis_view import diagnosis_view
    from ..engine.progress import Reporter

    diagnosis = diagnose_run(sources[0], Reporter(), machines_of(workers, scheduler))
    view = list(diagnosis_view(diagnosis))
    values = diagnosis.as_dict()
    if since is not None:
        from ..report.views.compare_view import changed_since
        from ..results.compare import compare_runs

        (comparison,) = compare_runs([since, sources[0]])
        view += changed_since(comparison)
        values |= {"since": str(since), "changes": comparison.as_dict()["causes"]}
    if as_json:
        print_json(values)
    else:
        print_view(view)


def _tell_apart(sources: list[Path], assignments: list[str] | None, *, as_json: bool) -> None:
    from ...schemas.settings import load
    from ..diagnose.diagnosis_view import tell_apart_view
    from ..diagnose.tell_apart import tell_apart_folders, tell_apart_run
    from ..results.finished import FinishedRun

    if len(sources) == 1:
        if assignments:
            raise typer.BadParameter("a run has its settings; leave out --set")
        values = tell_apart_run(FinishedRun(sources[0]))
    else:
        if len(sources) > 2:
            raise typer.BadParameter("expected one run, or two folders")
        values = tell_apart_folders(sources[0], sources[1], load(None, assignments or []))
    if as_json:
        print_json({"tell_apart": values})
    else:
        print_view(tell_apart_view(" and ".join(map(str, sources)), values))


def tasks(
    run: RunFolder,
    predictions: Annotated[
        tuple[Path, Path] | None, typer.Option(metavar="REAL_DIR SIM_DIR")
    ] = None,
    odometry: bool = False,
    as_json: AsJson = False,
) -> None:
    """Show what a perception stack gets from both scans: of a run with --tasks, or of your model.

    With --predictions, what your detector or segmenter said on both sides, as files named after the
    pairs: PAIR.label (a class for each point of the scan file), PAIR.txt (boxes, KITTI's label
    files) or PAIR.json (boxes, nuScenes' results). Shows agreement by class, the objects that are
    lost, and which scores go with a loss.

    Parameters
    ----------
    predictions : Folders of predictions on the real and on the simulated scans.
    odometry : Instead the motion that KISS-ICP finds on both sides, of scans that follow one
        another.

    Examples
    --------
    fidpipe tasks runs/dataset

    fidpipe tasks runs/dataset --predictions labels/real labels/sim

    fidpipe tasks runs/dataset --predictions boxes/real boxes/sim --json | jq '.objects'

    fidpipe tasks runs/dataset --odometry
    """
    from ..diagnose import predictions_view as views
    from ..diagnose.predictions import compare_predictions
    from ..report.views.run_view import tasks_view
    from ..results.finished import FinishedRun
    from ..results.odometry import compare_odometry

    if predictions and odometry:
        raise typer.BadParameter("expected --predictions or --odometry, got both")
    finished = FinishedRun(run)
    if predictions:
        agreement = compare_predictions(finished, *predictions)
        view = views.agreement_view(agreement)
        values: JsonValue = asdict(agreement)
    elif odometry:
        rows = compare_odometry(finished)
        view = views.odometry_view(rows)
        values = [*rows]
    else:
        finished.refuse_without_tasks()
        view = tasks_view(finished.record.tasks)
        values = [summary.as_dict() for summary in finished.record.tasks]
    if as_json:
        print_json(values)
    else:
        print_view(view)
