"""The commands that read finished runs: show. Parses, calls, prints, as `cli` does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import print_json, print_view

RunFolder = Annotated[Path, typer.Argument(help="Folder of a run, such as runs/dataset.", show_default=False)]


def show(
    run: RunFolder,
    pair: Annotated[str | None, typer.Argument(help="Name of a pair.", show_default=False)] = None,
    object_: Annotated[
        str | None,
        typer.Argument(metavar="[OBJECT]", help="Object of the pair: 7 of the real side, sim:7 of the simulated one."),
    ] = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's claims beside what is found here, a line each.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Strict JSON on standard output, nothing else.")] = False,
) -> None:
    """Show a finished run, one of its pairs, or one object; computes nothing.

    Examples
    --------
    fidpipe show runs/dataset                  the summary that the run ended with

    fidpipe show runs/dataset --paper          which of the paper's claims hold here

    fidpipe show runs/dataset 0007             the objects of a pair, worst first

    fidpipe show runs/dataset 0007 12          real object 12 and its simulated partner; sim:3 for a simulated one

    fidpipe show runs/dataset 0007 --json | jq '.objects[0].scores'
    """
    from .finished import FinishedRun
    from .report.findings_view import claims_view
    from .report.show_view import object_view, pair_view
    from .report.terminal import summary_view
    from .show import object_facts, pair_facts, run_facts

    if paper and pair is not None:
        raise typer.BadParameter("--paper is about the whole run; leave out the pair")
    finished = FinishedRun(run)
    if paper:
        claims = finished.record["findings"].get("claims", [])
        print_json(claims) if as_json else print_view(claims_view(claims))
    elif pair is None:
        print_json(run_facts(finished)) if as_json else print_view(summary_view(run, finished.rows, finished.record))
    elif object_ is None:
        found = pair_facts(finished, pair)
        print_json(found) if as_json else print_view(pair_view(found))
    else:
        found = object_facts(finished, pair, object_)
        print_json(found) if as_json else print_view(object_view(found))
