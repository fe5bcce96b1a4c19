"""The commands that show finished runs: show, report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import AsJson, Floor, RunFolder
from .output import print_json, print_view


def show(
    run: RunFolder,
    pair: Annotated[str | None, typer.Argument(help="Name of a pair.", show_default=False)] = None,
    object_: Annotated[
        str | None,
        typer.Argument(metavar="[OBJECT]", help="Object of the pair: 7 of the real side, sim:7 of the simulated one."),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's claims beside what is found here, one line each.")
    ] = False,
    floor: Floor = None,
    as_json: AsJson = False,
) -> None:
    """Show a finished run, one of its pairs, or one object; computes nothing.

    Examples
    --------
    fidpipe show runs/dataset                  the summary that the run ended with

    fidpipe show runs/dataset --paper          which of the paper's claims hold here

    fidpipe show runs/dataset 0007             the objects of a pair, worst first

    fidpipe show runs/dataset 0007 12          real object 12 and its simulated partner; sim:3 for a simulated one

    fidpipe show runs/dataset --floor runs/dataset-floor    each score over what a perfect simulator would score

    fidpipe show runs/dataset 0007 --json | jq '.objects[0].scores'
    """
    from rich.console import Group

    from ...schemas.results import JsonObject
    from ..report.terminal.floor import excess_view, pair_excess_view
    from ..report.terminal.run import claims_view, summary_view
    from ..report.terminal.show import object_view, pair_view
    from ..results.finished import FinishedRun, object_facts, pair_facts, run_facts
    from ..results.floor import excess_over

    if paper and pair is not None:
        raise typer.BadParameter("--paper is about the whole run; leave out the pair")
    if floor is not None and (paper or object_ is not None):
        raise typer.BadParameter("--floor is about the scores of a run or of a pair; leave out --paper and the object")
    finished = FinishedRun(run)
    excess = None if floor is None else excess_over(finished, floor, None if pair is None else [pair])
    over: JsonObject = {} if excess is None else {"excess": excess.as_dict()}
    if paper:
        claims = finished.record.claims
        print_json([claim.as_dict() for claim in claims]) if as_json else print_view(
            claims_view(finished.record.findings)
        )
    elif pair is None:
        summary = summary_view(run, finished.rows, finished.record)
        print_json(run_facts(finished) | over) if as_json else print_view(
            summary if excess is None else Group(summary, excess_view(excess))
        )
    elif object_ is None:
        facts = pair_facts(finished, pair)
        print_json(facts.as_dict() | over) if as_json else print_view(
            pair_view(facts) if excess is None else Group(pair_view(facts), pair_excess_view(excess, pair))
        )
    else:
        one = object_facts(finished, pair, object_)
        print_json({"pair_id": pair, **one.as_dict()}) if as_json else print_view(object_view(pair, one))


def report(
    run: RunFolder,
    pairs: Annotated[
        str | None,
        typer.Option("--pairs", metavar="PATTERN", help="Show pairs whose name matches in 3D, such as '0000*'."),
    ] = None,
    folder: Annotated[bool, typer.Option("--folder", help="One page per pair and an index, in RUN/report.")] = False,
    floor: Floor = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for page and figures.", show_default="the run's own")
    ] = None,
) -> None:
    """Make a page that shows a finished run, and the paper's figures; the page opens from disk and loads nothing.

    RUN/report.html: verdict, scores, missing and invented objects, tables, the points of some pairs in 3D (the worst,
    the middle and the best ones, or those of --pairs). RUN/figures: each figure as PNG and SVG.

    Examples
    --------
    fidpipe report runs/dataset

    fidpipe report runs/dataset --pairs '0007'

    fidpipe report runs/dataset --folder

    fidpipe report runs/dataset --floor runs/dataset-floor
    """
    from ..report.page.page import write_report

    made = write_report(run, pairs, one_page_a_pair=folder, out=out, floor=floor)
    pages = f" and {made.n_pages - 1} more" if made.n_pages > 1 else ""
    print(f"page:    {made.page}{pages} ({made.n_views} of {made.n_pairs} pairs in 3D)")
    print(f"figures: {made.figures[0].parent} ({', '.join(path.stem for path in made.figures[::2])}; PNG and SVG)")
