"""The command that explains the difference between real and simulated scans: diagnose."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import completion
from .options import AsJson, Assignments, SettingsFile
from .output import print_json, print_view


def diagnose(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN | REAL SIM",
            help="Folder of a run; with --tell-apart also two folders of scans (or recordings), which need no pairs.",
            show_default=False,
            autocompletion=completion.run_folders,
        ),
    ],
    floor: Annotated[
        Path | None,
        typer.Option("--floor", metavar="RUN", help="A run of fidpipe floor on the same real scans, for comparison."),
    ] = None,
    tell_apart: Annotated[
        bool, typer.Option("--tell-apart", help="Test if a classifier can distinguish real and simulated points.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PNG", help="With --tell-apart: map of the recognised points.")
    ] = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    as_json: AsJson = False,
) -> None:
    """Explain the difference between real and simulated scans.

    With --tell-apart: a classifier learns to recognise simulated points by their neighbourhood (shape, roughness,
    spacing, rays, intensity) and is tested on other places. AUC 0.5: it cannot; 1: it always can. Position has no
    influence. --settings and --set are for two folders.

    Examples
    --------
    fidpipe diagnose runs/dataset --tell-apart --picture map.png

    fidpipe diagnose runs/dataset --tell-apart --floor runs/dataset-floor --json

    fidpipe diagnose real/ sim/ --tell-apart --set input.sim_frame=carla
    """
    if len(sources) > 2:
        raise typer.BadParameter(f"expected a run or two folders, got {len(sources)}")
    if not tell_apart:
        raise typer.BadParameter("nothing to do; give --tell-apart")
    if len(sources) == 2 and floor:
        raise typer.BadParameter("--floor belongs to a run; give a run instead of two folders")
    if len(sources) == 1 and (settings or assignments):
        raise typer.BadParameter("--settings and --set are for two folders; a run has its settings")
    from ...schemas.settings import load
    from ..diagnose.tell_apart import tell_apart_folders, tell_apart_run
    from ..diagnose.tell_apart_view import draw_map, tell_apart_view
    from ..results.finished import FinishedRun

    if len(sources) == 2:
        found = tell_apart_folders(sources[0], sources[1], load(settings, assignments or []))
    else:
        found = tell_apart_run(FinishedRun(sources[0]), FinishedRun(floor) if floor else None)
    if picture:
        draw_map(found, picture)
    print_json({"tell_apart": found.as_dict()}) if as_json else print_view(tell_apart_view(found))
