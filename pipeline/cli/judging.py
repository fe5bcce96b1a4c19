"""The commands that evaluate finished runs: gate and compare."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from . import completion
from .options import (
    EXIT_GATE_FAILED,
    AsCsv,
    AsJson,
    AsMarkdown,
    Floor,
    OutFile,
    RunFolder,
    criterion_option,
    format_of,
    paired,
    run_folder,
)
from .output import print_as, print_view


def gate(
    run: RunFolder,
    at_most: Annotated[list[str] | None, criterion_option("--max")] = None,
    at_least: Annotated[list[str] | None, criterion_option("--min")] = None,
    criteria: Path | None = None,
    floor: Floor = None,
    junit: Annotated[Path | None, typer.Option(show_default="RUN/gate.xml")] = None,
    json_: Annotated[Path | None, typer.Option("--json-file", "--json", show_default="RUN/gate.json")] = None,
    out: Annotated[Path | None, typer.Option(show_default="the run's own")] = None,
) -> None:
    """Check a finished run against acceptance criteria; exits with 0 if all are met, with 4 if one is not.

    A criterion on a measure that could not be computed fails. So does a run with failed pairs, an unfinished run, and
    one whose scans have changed, unless pairs.failed, pairs.to_do and pairs.changed have other bounds. If the
    run's folder is read-only, the result is only printed.

    Measures: r_lambda.mean, cdc.max, match_rate.min (over pairs), objects.r_lambda.q95 (over objects),
    missing.within_20m, hallucinated.share, class.car.r_lambda.mean, class.car.missing.total, causes.height (its size;
    spaces are underscores); with --floor also excess.r_lambda.mean and excess.cdc.area; docs/gate.md has all.

    Parameters
    ----------
    at_most : Upper bound of a measure; repeatable.
    at_least : Lower bound of a measure; repeatable.
    criteria : TOML file of criteria, each with a name and a reason.
    junit : JUnit XML for CI.
    json_ : Result as JSON.
    out : Folder for gate.xml and gate.json.

    Examples
    --------
    fidpipe gate runs/dataset --max r_lambda.mean=0.4 --min match_rate.mean=0.55

    fidpipe gate runs/dataset --max missing.within_20m=3 --max pairs.failed=1 --junit build/gate.xml

    fidpipe gate runs/dataset --max causes.height=0.05 --max causes.missing_parts=0.02

    fidpipe gate runs/dataset --criteria acceptance.toml

    fidpipe gate runs/dataset --floor runs/dataset-floor --max excess.cdc.mean=0.1
    """
    from ..report.views.gate_view import gate_checks, gate_view, junit_xml
    from ..results.gate import judge_run, parse_word, read_criteria
    from ..storage.run_record import dumps

    wanted = read_criteria(criteria) if criteria else []
    wanted += [parse_word(word, "max") for word in at_most or []]
    wanted += [parse_word(word, "min") for word in at_least or []]
    if not wanted:
        raise typer.BadParameter("no criterion given; expected --max, --min or --criteria")
    result = judge_run(run, wanted, floor)
    folder = out or run
    _write_for_ci(junit, folder / "gate.xml", junit_xml("gate", {str(run): gate_checks(result)}), is_asked=bool(out))
    _write_for_ci(json_, folder / "gate.json", dumps(result.as_dict()), is_asked=bool(out))
    print_view(gate_view(result))
    raise typer.Exit(0 if result.passed else EXIT_GATE_FAILED)


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN_A RUN_B", autocompletion=completion.run_folders)],
    html: OutFile = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    floor: Floor = None,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    as_csv: AsCsv = False,
    fail_on: Annotated[str | None, typer.Option(metavar="VERDICT")] = None,
    junit: OutFile = None,
    json_file: OutFile = None,
    allow_different_settings: bool = False,
    independent: bool = False,
    all_: Annotated[bool, typer.Option("--all")] = False,
) -> None:
    """Compare simulator versions on the same real scans: better, worse or mixed, and in what.

    Causes and families of scores are decided, the families with at most 5 % false alarms over all; see
    docs/compare.md. Datasets and scans are evaluated first (preset reference). --fail-on worse exits with 4 if a cause
    or a family is worse or mixed, or a pair that the base has scored failed or is not compared; --fail-on undecided
    also if nothing is decided. It writes compare.xml and compare.json into the last run unless --junit, --json-file or
    --out say otherwise.

    Parameters
    ----------
    runs : Up to eight runs, the first is the base; or datasets, or real scans and several simulated folders.
    html : Write a web page.
    out : Folder for compare.html, .xml, .json.
    fail_on : Exit with 4 on worse, or also on undecided.
    junit : JUnit XML of --fail-on.
    json_file : JSON of --fail-on.
    allow_different_settings : Allow runs of other settings.
    independent : Treat each pair as independent.
    all_ : Show every score, class and range.

    Examples
    --------
    fidpipe compare runs/build41 runs/build42

    fidpipe compare drive/ build41/lidar/ build42/lidar/    real, two simulators

    fidpipe compare runs/base runs/new --floor runs/base-floor --html new.html

    fidpipe compare runs/base runs/new --fail-on worse --junit build/compare.xml

    fidpipe compare runs/build41 runs/build42 --markdown >> comment.md
    """
    from ..engine.progress import Reporter
    from ..report.views.compare_view import compare_records, compare_view
    from ..report.views.gate_view import base_view, junit_xml
    from ..results.compare import MOST_RUNS, compare_runs
    from ..results.gate import FAIL_ON, judge_comparison
    from ..storage.files import write_whole
    from ..storage.run_record import dumps

    if not 2 <= len(runs) <= MOST_RUNS:
        raise typer.BadParameter(f"{len(runs)} run{'s' * (len(runs) > 1)} given; expected 2 to {MOST_RUNS}")
    output = format_of(as_json, as_markdown, as_csv)
    if fail_on is not None and fail_on not in FAIL_ON:
        raise typer.BadParameter(f"--fail-on: expected {' or '.join(FAIL_ON)}, got {fail_on!r}")
    if fail_on is None and (junit or json_file):
        raise typer.BadParameter("--junit and --json-file are what --fail-on writes; give it as well")
    page = html or (out and out / "compare.html")
    runs = _evaluated(runs)
    comparisons = compare_runs(
        runs,
        allow_different_settings=allow_different_settings,
        floor=floor,
        independent=independent,
        reporter=Reporter(),
    )
    if page:
        from ..report.page.compare_page import compare_page

        write_whole(page, compare_page(comparisons, page.parent).encode())
    results = [judge_comparison(each, fail_on) for each in comparisons] if fail_on else []
    views = (compare_view(each, with_all=all_ or output == "markdown") for each in comparisons)
    print_as(
        output,
        view=lambda: [*chain(*views, *map(base_view, results))],
        records=lambda: compare_records(comparisons),
        values=lambda: [each.as_dict() for each in results or comparisons],
    )
    if results:
        suites = {f"{one.comparison.other} against {one.comparison.base}": one.checks for one in results}
        folder = out or runs[-1]
        _write_for_ci(junit, folder / "compare.xml", junit_xml("compare", suites), is_asked=bool(out))
        content = dumps({"comparisons": [one.as_dict() for one in results]})
        _write_for_ci(json_file, folder / "compare.json", content, is_asked=bool(out))
        raise typer.Exit(EXIT_GATE_FAILED if any(one.failed for one in results) else 0)


def _evaluated(folders: list[Path]) -> list[Path]:
    """Folders of runs; datasets, or several simulated sides after a real one, are evaluated first (`reference`)."""
    from ...schemas.errors import RunError
    from ...schemas.settings import load
    from ..datasets.pairs import scans_in
    from ..datasets.readers.scan_ref import scan_ref
    from ..engine.engine import Machines
    from ..engine.progress import Reporter
    from ..run import run_dataset
    from ..storage.files import path_exists
    from ..storage.urls import url_of_cache

    def has(folder: Path, *names: str) -> bool:
        return any(path_exists(folder / name) for name in names)

    for folder in folders:
        if not (url_of_cache(folder) or path_exists(scan_ref(folder).file)):
            raise RunError(f"{folder}: no such file or folder; nothing was evaluated")
    real, reporter, found = folders[0], Reporter(), []
    is_known = has(real, "run.json", "pairs.parquet", "real", "pairs.csv")
    is_side = scan_ref(real).format.holds_frames or (real.is_dir() and not is_known and bool(scans_in(real)))
    if is_side and len(folders) < 3:
        raise typer.BadParameter(f"{real} holds real scans; expected two or more simulated folders after it")
    names = [run_folder(folder) for folder in folders]
    for folder, name in list(zip(folders, names, strict=True))[is_side:]:
        if not is_side and (has(folder, "run.json") or not has(folder, "real", "pairs.csv")):
            found.append(folder)
            continue
        is_unique = names.count(name) == 1
        out = name if is_unique else name.with_name(f"{folder.resolve().parent.name}-{name.name}")
        reporter.say(f"{folder}: its run is {out}")
        dataset = paired(real, folder, out) if is_side else folder
        run_dataset(dataset, out, load(None, [], preset="reference"), reporter, machines=Machines())
        found.append(out)
    return found


def _write_for_ci(asked: Path | None, default: Path, content: bytes, *, is_asked: bool) -> None:
    """Write a file for CI; failing to write to a default path is only a warning, as the result is printed too."""
    from ...schemas.errors import RunError
    from ..engine.progress import Reporter
    from ..storage.files import write_whole

    try:
        write_whole(asked or default, content)
    except RunError as error:
        if asked or is_asked:
            raise
        Reporter().warn(str(error))
