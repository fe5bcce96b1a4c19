"""Writes the report of a run: the page, or a folder of pages with an index; and the figures."""

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
from ..run_frames import RunResults, read_results
from .page_templates import plotly_js, render
from .pair_data import MOST_POINTS, pair_data
from .run_data import page_data, page_words

PAGE = "report.html"
PAGES = "report"
FIGURES = "figures"
#: Number of pairs with points on a page, a third each of the worst, the middle and the best.
MOST_VIEWS = 15
_PLOTLY = "plotly.min.js"
_INDEX = "index.html"


@dataclass(frozen=True)
class ReportFiles:
    """Files written: the page to open, number of pages, figures, and number of pairs in 3D."""

    page: Path
    n_pages: int
    figures: list[Path]
    n_views: int
    n_pairs: int


@dataclass(frozen=True)
class _Page:
    """A page to be written: its file, the pairs that it shows in 3D, and a note on them."""

    path: Path
    pairs: list[str]
    note: str


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
    pattern : only pairs whose name matches are shown in 3D (shell style); the rest of the page is
        of all pairs
    out : folder that the files are written into; by default the run's own
    html : file of the single page; by default report.html in that folder
    best_case : the run of fidpipe best-case that scores are also shown over
    one_page_a_pair : write a folder of pages, one for each of those pairs, instead of the page
    with_figures : also write the paper's figures; maps are of the median of those pairs
    reporter : shows the progress over pairs

    Raises
    ------
    RunError
        The folder is not a finished run, has no scored pair or a damaged table, no pair matches, or
        a file cannot be written; or the best case is another's.
    """
    if with_figures:
        from ..figures.run_figures import draw_figures  # matplotlib takes a second to load
    results = read_results(folder)
    excess = None if best_case is None else excess_over(results.run, best_case)
    folder = out or folder
    chosen = results.select(pattern)
    files = {}
    plotly_source = ""
    if one_page_a_pair:
        files = {name: f"pair-{file_stem(name)}.html" for name in chosen}
        pages = _pair_pages(folder / PAGES, files)
        plotly_source = _PLOTLY
        write_whole(folder / PAGES / _PLOTLY, plotly_js().encode())
    else:
        pages = [_run_page(html or folder / PAGE, results, chosen)]
    # An address must escape the per cent signs that the names of the files hold.
    links = {name: quote(file) for name, file in files.items()}
    data = page_data(results) | {"links": links}
    words = page_words(results, excess)
    n_views = sum(len(page.pairs) for page in pages)
    show = reporter or Reporter()
    show.start(n_views, n_views)
    for page in pages:
        views: dict[str, dict[str, Any]] = {}
        for name in page.pairs:
            views[name] = pair_data(results, name, MOST_POINTS // len(page.pairs))
            show.advance(1, 1)
        report = {**data, "views": views}
        content = render("report.html", report, plotly_source, view_note=page.note, **words)
        write_whole(page.path, content.encode())
    show.stop()
    figures = []
    if with_figures:
        figures = draw_figures(results, chosen[len(chosen) // 2], folder / FIGURES)
    return ReportFiles(pages[-1].path, len(pages), figures, n_views, len(results.pairs))


def _run_page(path: Path, results: RunResults, chosen: list[str]) -> _Page:
    """The single page, which shows some pairs in 3D."""
    overview = results.run.overview
    of_worst = {piece.pair_id for piece in overview.pieces} if overview else set()
    shown = views_of(chosen, of_worst)
    return _Page(path, shown, _view_note(len(shown), len(results.pairs)))


def _pair_pages(folder: Path, files: dict[str, str]) -> list[_Page]:
    """A page for each pair, and the index; removes those of pairs that are no longer shown."""
    note = "This page shows one pair; the tables lead to the others."
    pages = [_Page(folder / file, [name], note) for name, file in files.items()]
    for path in {*folder.glob("pair-*.html")} - {page.path for page in pages}:
        remove_stale(path)
    note = f"The 3D views of {len(files)} pairs are on separate pages: choose one in the tables."
    return [*pages, _Page(folder / _INDEX, [], note)]


def views_of(names: list[str], of_worst: Container[str]) -> list[str]:
    """The pairs that one page shows in 3D, in their order: some of all, and those of pieces.

    of_worst : pairs that the largest pieces are in
    """
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


def _view_note(n_shown: int, n_all: int) -> str:
    if n_shown == n_all:
        return f"All {n_all} pairs, worst first." if n_all > 1 else ""
    return (
        f"Of {n_all} pairs the page holds the points of {n_shown}, worst first: mainly the worst, "
        "the best, some in the middle, and those of the largest pieces. --pairs PATTERN chooses "
        "others, --folder makes a page for each."
    )
