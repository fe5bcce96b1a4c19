"""Writes the report of a run: the page, or a folder with one page per pair and an index, and the figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from plotly.offline import get_plotlyjs

from ...storage.files import remove_stale, write_whole
from ...storage.tables import file_stem
from ..figures.run import draw_figures
from ..results import RunResults, read_results
from .data import page_data, page_words
from .pair import pair_view
from .render import render

PAGE = "report.html"
PAGES = "report"
FIGURES = "figures"
#: A page holds the points of so many pairs at most: a third of them worst, median and best each.
MOST_VIEWS = 15
_TEMPLATE = "report.html"
_PLOTLY = "plotly.min.js"
_INDEX = "index.html"
_PAIR_PAGES = "pair-*.html"


@dataclass(frozen=True)
class ReportFiles:
    """What was written: the page to open, the number of pages, the figures, how many of the pairs are there in 3D."""

    page: Path
    n_pages: int
    figures: list[Path]
    n_views: int
    n_pairs: int


def write_report(folder: Path, pattern: str | None = None, *, one_page_a_pair: bool = False) -> ReportFiles:
    """Writes the page and the figures of a finished run into its folder, in place of those of an earlier report.

    Parameters
    ----------
    folder : of the run
    pattern : only pairs whose name matches are shown in 3D (shell style); the rest of the page is of all pairs
    one_page_a_pair : whether to write a folder of pages, one for each of those pairs, in place of the single page

    Raises
    ------
    RunError
        The folder is no finished run, has no scored pair or a damaged table, no pair matches, or a file cannot be
        written.
    """
    results = read_results(folder)
    chosen = results.select(pattern)
    if one_page_a_pair:
        page, n_pages, n_views = *_write_folder(results, chosen), len(chosen)
        remove_stale(folder / PAGE)
    else:
        shown = some_of(chosen, MOST_VIEWS)
        report = {**page_data(results), "views": {name: pair_view(results, name) for name in shown}, "links": {}}
        note = _view_note(len(shown), len(chosen), len(results.pairs), pattern)
        page, n_pages, n_views = folder / PAGE, 1, len(shown)
        write_whole(page, render(_TEMPLATE, report, view_note=note, **page_words(results)).encode())
        _remove_folder(folder / PAGES)
    figures = draw_figures(results, chosen, folder / FIGURES)
    return ReportFiles(page, n_pages, figures, n_views, len(results.pairs))


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


def _write_folder(results: RunResults, chosen: list[str]) -> tuple[Path, int]:
    """The index and the number of pages: one per pair, with one plotly.js for all; earlier pages go away."""
    folder = results.run.folder / PAGES
    write_whole(folder / _PLOTLY, get_plotlyjs().encode())
    files = {name: f"pair-{file_stem(name)}.html" for name in chosen}
    # An address must escape the per cent signs that the names of the files hold.
    data = page_data(results) | {"links": {name: quote(file) for name, file in files.items()}}
    words = page_words(results)

    def write(file: str, views: dict[str, Any], note: str) -> None:
        page = render(_TEMPLATE, {**data, "views": views}, _PLOTLY, view_note=note, **words)
        write_whole(folder / file, page.encode())

    for name, file in files.items():
        write(file, {name: pair_view(results, name)}, "This page shows one pair; the tables lead to the others.")
    write(_INDEX, {}, f"The 3D views of {len(chosen)} pairs have pages of their own: choose one in the tables.")
    for path in folder.glob(_PAIR_PAGES):
        if path.name not in files.values():
            remove_stale(path)
    return folder / _INDEX, len(chosen) + 1


def _remove_folder(folder: Path) -> None:
    """Removes the pages that an earlier report wrote; a folder in which there is something else stays."""
    for path in (folder / _INDEX, folder / _PLOTLY, *folder.glob(_PAIR_PAGES)):
        remove_stale(path)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _view_note(n_shown: int, n_chosen: int, n_all: int, pattern: str | None) -> str:
    if n_shown == n_all:
        return f"All {n_all} pairs, worst first." if n_all > 1 else ""
    chosen = f"the {n_chosen} pairs that match {pattern}" if pattern else f"{n_all} pairs"
    if n_shown == n_chosen:
        return f"{chosen.capitalize() if pattern else chosen}, worst first."
    n = n_shown // 3
    return (
        f"Of {chosen} the page holds the points of {n_shown}: the {n} worst, {n} in the middle and the {n} best. "
        "--pairs PATTERN chooses others, --folder makes a page for each."
    )
