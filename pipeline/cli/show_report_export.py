"""The commands that show or export finished runs: show, report, export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import AsJson, BestCase, Pairs, RunFolder
from .output import print_json, print_line, print_view


def show(
    run: RunFolder,
    pair: Annotated[str | None, typer.Argument()] = None,
    object_: Annotated[str | None, typer.Argument(metavar="OBJECT")] = None,
    all_: Annotated[bool, typer.Option("--all")] = False,
    best_case: BestCase = None,
    as_json: AsJson = False,
) -> None:
    """Show a finished run, one of its pairs, or one object.

    Parameters
    ----------
    pair : Name of a pair.
    object_ : Object of the pair: 7 of the real side, sim:7 of the simulated one.
    all_ : All tables of a run; all objects of a pair.

    Examples
    --------
    fidpipe show runs/dataset                  the summary of the run; --all for every table

    fidpipe show runs/dataset 0007             the objects of a pair, worst first

    fidpipe show runs/dataset 0007 12          real object 12; sim:3 for a simulated one

    fidpipe show runs/dataset --best-case runs/dataset-best-case    minus a perfect simulator

    fidpipe show runs/dataset 0007 --json | jq '.objects[0].real.r_lambda'
    """
    if best_case is not None and pair is not None:
        raise typer.BadParameter("--best-case is about a run; leave out the pair")

    from ..report.views.show_view import show_json, show_view
    from ..results.best_case import excess_over
    from ..results.finished import FinishedRun

    finished = FinishedRun(run)
    excess = None if best_case is None else excess_over(finished, best_case)
    if as_json:
        print_json(show_json(finished, pair, object_, excess))
    else:
        print_view(show_view(finished, pair, object_, excess, with_all=all_))


def report(
    run: RunFolder,
    pairs: Pairs = None,
    figures: bool = False,
    best_case: BestCase = None,
    out: Path | None = None,
    html: Path | None = None,
    opens: Annotated[bool, typer.Option("--open")] = False,
) -> None:
    """Make a self-contained web page of a finished run, and with --figures the paper's figures.

    RUN/report.html: surface, what to fix first, worst places, scores, tables, points of some pairs
    in 3D (the worst, the middle and the best ones, or those of --pairs).

    An address that ends in #pair=0007&object=real%203 opens the page at that object.

    Parameters
    ----------
    pairs : Show pairs whose name matches in 3D, such as '0000*'.
    figures : Also draw the figures for print, in RUN/figures, as PNG, SVG and PDF.
    out : Folder for page and figures, else the run's own.
    html : Write the page to this file.
    opens : Open the page in the browser.

    Examples
    --------
    fidpipe report runs/dataset --open

    fidpipe report runs/dataset --pairs '0007'

    fidpipe report runs/dataset --figures

    fidpipe report runs/dataset --best-case runs/dataset-best-case
    """
    import webbrowser

    from ..engine.progress import Reporter
    from ..report.page.run_page import write_report

    files = write_report(
        run,
        pairs,
        out=out,
        html=html,
        best_case=best_case,
        with_figures=figures,
    )
    print_line(f"page:    {files.page} ({files.n_views} of {files.n_pairs} pairs in 3D)")
    if files.figures:
        names = ", ".join(dict.fromkeys(path.stem for path in files.figures))
        print_line(f"figures: {files.figures[0].parent} ({names}; PNG, SVG and PDF)")
    if opens and not webbrowser.open(files.page.resolve().as_uri()):
        Reporter().warn(f"no browser could be started; open {files.page} in one")


def export(
    run: RunFolder,
    mcap: bool = False,
    ply: bool = False,
    pairs: Pairs = None,
    out: Path | None = None,
    replace: bool = False,
) -> None:
    """Write points with their scores for Foxglove, Lichtblick, rerun or CloudCompare.

    Each clean point has x, y, z, community (its object, -1: ground), r_lambda, cdc, distance_m (to
    the other side; NaN if it has no points) and status: 0 ground, 1 scored, 2 identical, 3
    too_small, 4 not_found, 5 extra.

    MCAP topics: /fidpipe/real and /fidpipe/sim, /fidpipe/real_objects and /fidpipe/sim_objects (a
    point per object, at its centroid), all sensor_msgs/msg/PointCloud2, and /fidpipe/scores (a
    pair's scores as JSON). Stamps are those of the dataset if every pair has one, otherwise a
    second apart.

    Parameters
    ----------
    mcap : One MCAP file of ROS 2 messages, NAME.mcap; needs the extra ros.
    ply : Two PLY files per pair, PAIR.real.ply and PAIR.sim.ply, with scalar fields.
    out : Folder for the files, else RUN/export.
    replace : Replace existing files.

    Examples
    --------
    fidpipe export runs/dataset --mcap                     one file for Foxglove

    fidpipe export runs/dataset --ply --pairs '0007'       two files for CloudCompare

    fidpipe export runs/dataset --mcap --ply --out viewers/
    """
    from ..engine.progress import Reporter
    from ..exchange.export import export_run
    from ..results.finished import FinishedRun

    if not (mcap or ply):
        raise typer.BadParameter("no format given; expected --mcap, --ply or both")
    reporter = Reporter()
    finished = FinishedRun(run)
    lines = export_run(
        finished,
        out or run / "export",
        pairs,
        mcap=mcap,
        ply=ply,
        replace=replace,
        counted=reporter.counted,
    )
    n_failed = finished.record.pairs.failed
    if n_failed:
        reporter.warn(f"{n_failed} pairs of the run failed and have no points to export")
    for line in lines:
        print_line(line)
