"""The commands that evaluate finished runs: gate and compare."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .options import (
    EXIT_GATE_FAILED,
    AsJson,
    Assignments,
    BestCase,
    Preset,
    RunFolder,
    SettingsFile,
    Workers,
    machines_of,
)
from .output import print_json, print_view

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..results.compare import Comparison
    from ..results.gate import BaseResult, Check, Judged


def gate(
    run: RunFolder,
    at_most: Annotated[
        list[str] | None, typer.Option("--max", metavar="MEASURE=NUMBER")
    ] = None,
    at_least: Annotated[
        list[str] | None, typer.Option("--min", metavar="MEASURE=NUMBER")
    ] = None,
    criteria: Path | None = None,
    best_case: BestCase = None,
    out: Path | None = None,
) -> None:
    """Check a run against acceptance criteria; exits with 0 if all are met, with 4 if not.

    A criterion on a measure that could not be computed fails. So does a run with failed pairs, an
    unfinished run, and one whose scans have changed, unless pairs.failed, pairs.to_do and
    pairs.changed have other bounds. Writes gate.xml (JUnit) and gate.json into the run; if that is
    read-only, the result is only printed.

    Measures: r_lambda.mean, cdc.max, match_rate.min (over pairs), objects.r_lambda.q95 (over
    objects), not_found.within_20m, extra.share, class.car.r_lambda.mean,
    class.car.not_found.total, causes.height (its size; spaces are underscores),
    tasks.objects.lost; with --best-case also excess.r_lambda.mean and excess.cdc.area;
    docs/gate.md has all.

    Parameters
    ----------
    at_most : Upper bound of a measure; repeatable.
    at_least : Lower bound of a measure; repeatable.
    criteria : TOML file of criteria, each with a name and a reason.
    out : Folder for gate.xml and gate.json, else the run's own.

    Examples
    --------
    fidpipe gate runs/dataset --max r_lambda.mean=0.4 --min match_rate.mean=0.55

    fidpipe gate runs/dataset --max not_found.within_20m=3 --max pairs.failed=1 --out build

    fidpipe gate runs/dataset --max causes.height=0.05 --max causes.missing_parts=0.02

    fidpipe gate runs/dataset --criteria acceptance.toml

    fidpipe gate runs/dataset --best-case runs/dataset-best-case --max excess.cdc.mean=0.1
    """
    from ..report.views.gate_view import gate_view
    from ..results.gate import judge_run, parse_word, read_criteria

    wanted = read_criteria(criteria) if criteria else []
    wanted += [parse_word(word, "max") for word in at_most or []]
    wanted += [parse_word(word, "min") for word in at_least or []]
    if not wanted:
        raise typer.BadParameter("no criterion given; expected --max, --min or --criteria")
    result = judge_run(run, wanted, best_case)
    suites = {str(run): result.judged}
    _write_for_ci("gate", suites, result.as_dict(), run, out)
    print_view(gate_view(result))
    raise typer.Exit(0 if result.passed else EXIT_GATE_FAILED)


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN_A RUN_B")],
    html: Path | None = None,
    out: Path | None = None,
    as_json: AsJson = False,
    fail_on: Literal["worse", "undecided"] | None = None,
    undecided_ok: bool = False,
    allow_different_settings: bool = False,
    independent: bool = False,
    all_: Annotated[bool, typer.Option("--all")] = False,
    preset: Preset = "reference",
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
) -> None:
    """Compare simulator versions on the same real scans: better, worse or mixed, and in what.

    Causes and families of scores are decided, the families with at most 5 % false alarms over all;
    see docs/compare.md. Datasets and scans are evaluated first, with --preset, --settings, --set
    and --workers. --fail-on worse exits with 4 if a cause or a family is worse or mixed, if a pair
    that the base has scored failed or is not compared, and if the comparison is undecided for lack
    of places (unless --undecided-ok); --fail-on undecided also if nothing is decided. It writes
    compare.xml (JUnit) and compare.json into the last run, or into the folder of --out.

    Parameters
    ----------
    runs : Two or more runs, the first is the base; or datasets, or real scans and several simulated
        folders.
    html : Write a web page to this file.
    out : Folder for compare.html, .xml, .json.
    fail_on : Exit with 4 on worse, or also on undecided.
    undecided_ok : Accept a comparison that too few places leave undecided.
    allow_different_settings : Allow runs of other settings.
    independent : Treat each pair as independent.
    all_ : Show every score and the objects that changed most.

    Examples
    --------
    fidpipe compare runs/build41 runs/build42

    fidpipe compare drive/ build41/lidar/ build42/lidar/    real, two simulators

    fidpipe compare drive/ build41/ build42/ --set input.sim_frame=carla --workers 8

    fidpipe compare runs/base runs/new --html new.html

    fidpipe compare runs/base runs/new --fail-on worse --out build
    """
    from ..report.views.compare_view import compare_view
    from ..report.views.gate_view import base_view
    from ..results.compare import compare_runs
    from ..results.gate import judge_comparison

    if undecided_ok and fail_on != "worse":
        raise typer.BadParameter("--undecided-ok is for --fail-on worse")
    evaluated = _evaluated(runs, preset, settings, assignments, workers)
    comparisons = compare_runs(
        evaluated, allow_different_settings=allow_different_settings, independent=independent
    )
    if page := html or (out and out / "compare.html"):
        _write_page(comparisons, page)
    results = []
    if fail_on:
        results = [judge_comparison(c, fail_on, undecided_ok=undecided_ok) for c in comparisons]
    if as_json:
        print_json([result.as_dict() for result in results or comparisons])
    else:
        views = [compare_view(comparison, with_all=all_) for comparison in comparisons]
        print_view([*chain(*views, *map(base_view, results))])
    if results:
        _end_gate(results, evaluated[-1], out)


def _evaluated(
    runs: list[Path],
    preset: str | None,
    settings: Path | None,
    assignments: list[str] | None,
    workers: int | None,
) -> list[Path]:
    """Folders of runs, after datasets and scans are evaluated.

    Raises `typer.BadParameter` for a single run, or settings of finished ones.
    """
    from ...schemas.settings import load
    from ..builds import is_run, is_side, runs_of
    from ..engine.progress import Reporter

    if len(runs) < 2:
        raise typer.BadParameter("expected two or more runs, got 1")
    has_settings = settings or assignments or preset != "reference"
    if has_settings and all(map(is_run, runs)) and not is_side(runs[0]):
        raise typer.BadParameter(
            "--preset, --set and --settings are for datasets and scans; these are runs"
        )
    in_force = load(settings, assignments or [], preset=preset)
    return runs_of(runs, in_force, Reporter(), machines_of(workers))


def _write_page(comparisons: list[Comparison], page: Path) -> None:
    from ..report.page.compare_page import compare_page
    from ..storage.files import write_whole

    write_whole(page, compare_page(comparisons).encode())


def _end_gate(results: list[BaseResult], run: Path, out: Path | None) -> None:
    """Write the results of `compare --fail-on` for CI, and raise `typer.Exit` with its code."""
    suites = {}
    for result in results:
        suites[f"{result.comparison.other} against {result.comparison.base}"] = result.checks
    content = {"comparisons": [result.as_dict() for result in results]}
    _write_for_ci("compare", suites, content, run, out)
    raise typer.Exit(EXIT_GATE_FAILED if any(result.failed for result in results) else 0)


def _write_for_ci(
    name: str,
    suites: Mapping[str, Sequence[Check | Judged]],
    content: dict[str, Any],
    run: Path,
    out: Path | None,
) -> None:
    """Write JUnit XML and JSON, by default into the run, where a failure to write is only a warning."""
    from ...schemas.errors import RunError
    from ..engine.progress import Reporter
    from ..report.views.gate_view import junit_xml
    from ..storage.files import write_whole
    from ..storage.run_record import dumps

    files = {"xml": junit_xml(name, suites), "json": dumps(content)}
    for suffix, text in files.items():
        try:
            write_whole((out or run) / f"{name}.{suffix}", text)
        except RunError as error:
            if out:
                raise
            Reporter().warn(str(error))
