"""The commands that read finished runs: show, report, gate, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import EXIT_GATE_FAILED, AsJson, Floor, RunFolder
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
    the middle and the best ones, or those of --pairs). RUN/figures: each figure as PNG, SVG and PDF.

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
    names = ", ".join(dict.fromkeys(path.stem for path in made.figures))
    print(f"figures: {made.figures[0].parent} ({names}; PNG, SVG and PDF)")


def gate(
    run: RunFolder,
    at_most: Annotated[
        list[str] | None,
        typer.Option("--max", metavar="MEASURE=NUMBER", help="The measure may be at most this; repeatable."),
    ] = None,
    at_least: Annotated[
        list[str] | None,
        typer.Option("--min", metavar="MEASURE=NUMBER", help="The measure must be at least this; repeatable."),
    ] = None,
    criteria: Annotated[
        Path | None, typer.Option("--criteria", help="TOML file of criteria, each with a name and a reason.")
    ] = None,
    floor: Floor = None,
    junit: Annotated[
        Path | None, typer.Option("--junit", help="JUnit XML for CI.", show_default="RUN/gate.xml")
    ] = None,
    json_: Annotated[
        Path | None, typer.Option("--json", help="The same as JSON.", show_default="RUN/gate.json")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for gate.xml and gate.json.", show_default="the run's own")
    ] = None,
) -> None:
    """Judge a finished run by acceptance criteria; exits with 0 if all are met, with 4 if one is not.

    A criterion on something that could not be computed fails. So do, unless other bounds are given for pairs.failed,
    pairs.to_do and pairs.changed, a run with failed pairs, one that is not finished, and one whose scans have changed.
    Where the run's folder may not be written (a read-only medium), the verdict is printed alone.

    Measures: r_lambda.mean, cdc.max, match_rate.min (over pairs), objects.r_lambda.q95 (over objects),
    missing.within_20m, hallucinated.share, class.car.r_lambda.mean, class.car.missing.total; with --floor also
    excess.r_lambda.mean and excess.cdc.area; a wrong name lists all.

    Examples
    --------
    fidpipe gate runs/dataset --max r_lambda.mean=0.4 --min match_rate.mean=0.55

    fidpipe gate runs/dataset --max missing.within_20m=3 --max pairs.failed=1 --junit build/gate.xml

    fidpipe gate runs/dataset --criteria acceptance.toml

    fidpipe gate runs/dataset --floor runs/dataset-floor --max excess.cdc.mean=0.1
    """
    from ...schemas.errors import RunError
    from ..engine.progress import Reporter
    from ..report.terminal.gate import gate_view, junit_xml
    from ..results.gate import judge_run, parse_word, read_criteria
    from ..storage.files import write_whole
    from ..storage.record import dumps

    wanted = read_criteria(criteria) if criteria else []
    wanted += [parse_word(word, "max") for word in at_most or []]
    wanted += [parse_word(word, "min") for word in at_least or []]
    if not wanted:
        raise typer.BadParameter("no criterion is given; --max, --min or --criteria is wanted")
    result = judge_run(run, wanted, floor)
    for asked, name, content in (
        (junit, "gate.xml", junit_xml(result)),
        (json_, "gate.json", dumps(result.as_dict())),
    ):
        try:
            write_whole(asked or (out or run) / name, content)
        except RunError as error:
            if asked or out:
                raise
            Reporter().warn(str(error))  # the verdict does not depend on it
    print_view(gate_view(result))
    raise typer.Exit(0 if result.passed else EXIT_GATE_FAILED)


def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN_A RUN_B [RUN_C]...", help="Folders of runs; the first is the base.", show_default=False
        ),
    ],
    html: Annotated[Path | None, typer.Option("--html", help="Write a page of its own to this file.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write compare.html to this folder.")] = None,
    floor: Floor = None,
    as_json: AsJson = False,
    allow_different_settings: Annotated[
        bool, typer.Option("--allow-different-settings", help="Compare runs all the same whose settings differ.")
    ] = False,
) -> None:
    """Compare simulator versions on the same real scans: which scores, and which objects, got better or worse.

    Differences are paired (Student's t over pairs, Holm over the scores). Real objects are followed from run to run:
    those that vanished from the simulation, appeared in it, got better or worse.

    Examples
    --------
    fidpipe compare runs/build41 runs/build42

    fidpipe compare runs/build40 runs/build41 runs/build42 --html builds.html

    fidpipe compare runs/build41 runs/build42 --floor runs/build41-floor    says which differences are smaller than it
    """
    from ..report.page.compare import compare_page
    from ..report.terminal.compare import compare_view
    from ..results.compare import compare_runs
    from ..storage.files import write_whole

    if len(runs) < 2:
        raise typer.BadParameter("one run is given, two or more are wanted")
    comparisons = compare_runs(runs, allow_different_settings=allow_different_settings, floor=floor)
    if page := html or (out and out / "compare.html"):
        write_whole(page, compare_page(comparisons).encode())
    print_json([each.as_dict() for each in comparisons]) if as_json else print_view(compare_view(comparisons))
