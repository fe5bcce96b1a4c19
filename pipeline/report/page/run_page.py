"""Writes the report of a run: the page, or a folder with one page per pair and an index, and the figures."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ...engine.progress import Reporter
from ...results.best_case import excess_over
from ...storage.files import remove_stale, write_whole
from ...storage.table_files import file_stem
from ..run_frames import read_results
from .page_templates import plotly_js, render
from .pair_data import MOST_POINTS, pair_data
from .run_data import page_data, page_words

PAGE = "report.html"
PAGES = "report"
FIGURES = "figures"
#: Number of pairs with points on a page, a third each of the worst, median and best, and those of the largest pieces.
MOST_VIEWS = 15
_PLOTLY = "plotly.min.js"
_INDEX = "index.html"


@dataclass(frozen=True)
class ReportFiles:
    """Files written: the page to open, the number of pages, the figures, and the number of pairs in 3D."""

    page: Path
    n_pages: int
    figures: list[Path]
    n_views: int
    n_pairs: int


def write_report(
    folder: Path,
    pattern: str | None = None,
    *,
    one_page_a_pair: bool = False,
    out: Path | None = None,
    html: Path | None = None,
    best_case: Path | None = None,
    with_figures: bool = False,
    reporter: Reporter | None = None,
) -> ReportFiles:
    """Write the page of a finished run, in place of that of an earlier report.

    Parameters
    ----------
    folder : of the run
    pattern : only pairs whose name matches are shown in 3D (shell style); the rest of the page is of all pairs
    out : folder that they are written into; by default the run's own
    html : file of the single page; by default report.html in that folder
    best_case : the run of fidpipe best-case that scores are also shown over
    one_page_a_pair : write a folder of pages, one for each of those pairs, instead of the single page
    with_figures : write the figures for print, too
    reporter : shows the progress over pairs

    Raises
    ------
    RunError
        The folder is not a finished run, has no scored pair or a damaged table, no pair matches, or a file cannot be
        written; or the best case is another's.
    """
    if with_figures:
        from ..figures.run_figures import draw_figures  # matplotlib takes a second to load
    results = read_results(folder)
    excess = None if best_case is None else excess_over(results.run, best_case)
    folder = out or folder
    chosen = results.select(pattern)
    overview = results.run.overview
    of_worst = {one.pair_id for one in overview.pieces} if overview else set()
    shown = chosen if one_page_a_pair else views_of(chosen, of_worst)
    files = {name: f"pair-{file_stem(name)}.html" for name in chosen} if one_page_a_pair else {}
    # An address must escape the per cent signs that the names of the files hold.
    data = page_data(results) | {"links": {name: quote(file) for name, file in files.items()}}
    words, plotly_source = page_words(results, excess), ""
    pages = {html or folder / PAGE: (shown, _view_note(len(shown), len(chosen), len(results.pairs), pattern))}
    if one_page_a_pair:
        pages = {
            folder / PAGES / file: ([name], "This page shows one pair; the tables lead to the others.")
            for name, file in files.items()
        }
        note = f"The 3D views of {len(chosen)} pairs are on separate pages: choose one in the tables."
        pages[folder / PAGES / _INDEX] = ([], note)
        plotly_source = _PLOTLY
        write_whole(folder / PAGES / _PLOTLY, plotly_js().encode())
    show = reporter or Reporter()
    show.start(len(shown), len(shown))
    for page, (names, note) in pages.items():
        views: dict[str, dict[str, Any]] = {}
        for name in names:
            views[name] = pair_data(results, name, MOST_POINTS // len(names))
            show.advance(1, 1)
        content = render("report.html", {**data, "views": views}, plotly_source, view_note=note, **words)
        write_whole(page, content.encode())
    show.stop()
    if html is None:
        _remove_others(folder, {*pages, folder / PAGES / plotly_source})
    figures = draw_figures(results, chosen, folder / FIGURES) if with_figures else []
    return ReportFiles(page, len(pages), figures, len(shown), len(results.pairs))


def views_of(names: list[str], of_worst: Container[str]) -> list[str]:
    """The pairs that one page shows in 3D, in their order: some of all, and those that the largest pieces are in."""
    some = some_of(names, MOST_VIEWS)
    return [name for name in names if name in some or name in of_worst]


def some_of(names: list[str], most: int) -> list[str]:
    """All names if they are few, else as many from the beginning, the middle and the end.

    Examples
    --------
    >>> "".join(some_of(list("abcdefghijk"), 6))
    'abefjk'
    """
    if len(names) <= most:
        return names
    n = most // 3
    middle = (len(names) - n) // 2
    return names[:n] + names[middle : middle + n] + names[-n:]


def _remove_others(folder: Path, written: set[Path]) -> None:
    """Removes the pages that only an earlier report wrote; a folder in which there is something else stays."""
    pages = folder / PAGES
    for path in {folder / PAGE, pages / _INDEX, pages / _PLOTLY, *pages.glob("pair-*.html")} - written:
        remove_stale(path)
    if pages.is_dir() and not any(pages.iterdir()):
        pages.rmdir()


def _view_note(n_shown: int, n_chosen: int, n_all: int, pattern: str | None) -> str:
    if n_shown == n_all:
        return f"All {n_all} pairs, worst first." if n_all > 1 else ""
    chosen = f"the {n_chosen} pairs that match {pattern}" if pattern else f"{n_all} pairs"
    if n_shown == n_chosen:
        return f"{chosen.capitalize() if pattern else chosen}, worst first."
    n, besides = MOST_VIEWS // 3, " and those of the largest pieces" if n_shown > MOST_VIEWS else ""
    return (
        f"Of {chosen} the page holds the points of {n_shown}: the {n} worst, {n} in the middle, the {n} best{besides}. "
        "--pairs PATTERN chooses others, --folder makes a page for each."
    )
