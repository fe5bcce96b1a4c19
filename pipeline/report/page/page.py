"""Writes the report of a run: the page, or a folder with one page a pair and an index, and the figures.

Everything is inside the page: the data as JSON, the code and plotly.js as installed. A name of a pair or a class
reaches the page as JSON only, in which no sign can end the script it stands in.
Leaves to others: the content (`page_data`, `pair_view`), the drawing (`assets`, `figures`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from ...storage.files import remove_stale, write_whole
from ...storage.store import file_stem
from ..figures.run import draw_figures
from ..results import RunResults, read_results
from .data import page_data
from .pair import pair_view

PAGE = "report.html"
PAGES = "report"
FIGURES = "figures"
#: A page holds the points of so many pairs at most: a third of them worst, median and best each.
MOST_VIEWS = 15
_PLOTLY = "plotly.min.js"
_INDEX = "index.html"
_PAIR_PAGES = "pair-*.html"
_CODE = ("base.js", "charts.js", "tables.js", "scene.js", "page.js")


@dataclass(frozen=True)
class ReportFiles:
    """What was written: the page to open, all pages' number, the figures, and which pairs can be looked at in 3D."""

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
    one_page_a_pair : a folder of pages, one for each of those pairs, in place of the single page

    Raises
    ------
    RunError
        The folder is no finished run, has no scored pair, or no pair matches.
    """
    results = read_results(folder)
    chosen = results.select(pattern)
    data = page_data(results)
    if one_page_a_pair:
        page, n_pages, n_views = *_write_folder(results, data, chosen), len(chosen)
        remove_stale(folder / PAGE)
    else:
        shown = some_of(chosen, MOST_VIEWS)
        data |= {"views": {name: pair_view(results, name) for name in shown}}
        data |= {"view_note": _view_note(len(shown), len(chosen), len(results.pairs), pattern)}
        page, n_pages, n_views = folder / PAGE, 1, len(shown)
        write_whole(page, render(data, f"<script>{_plotly()}</script>").encode())
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


def render(data: dict[str, Any], plotly: str, script_source: str = "") -> str:
    """The page with its data.

    Parameters
    ----------
    plotly : the element that brings plotly.js
    script_source : where else than in the page scripts may come from
    """
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    parts = {
        "style": _asset("page.css"),
        "script_source": script_source,
        "report": text,
        "plotly": plotly,
        "code": "</script>\n<script>".join(_asset(name) for name in _CODE),
    }
    page = _asset("page.html")
    filled = [page.partition("{{")[0]]
    for piece in page.split("{{")[1:]:
        name, _, rest = piece.partition("}}")
        filled += [parts[name], rest]
    return "".join(filled)


def _write_folder(results: RunResults, data: dict[str, Any], chosen: list[str]) -> tuple[Path, int]:
    """One page a pair and an index, with one plotly.js for all; pages of an earlier report go away."""
    folder = results.run.folder / PAGES
    plotly, source = f'<script src="{_PLOTLY}"></script>', " 'self' file:"
    write_whole(folder / _PLOTLY, _plotly().encode())
    links = {name: f"pair-{file_stem(name)}.html" for name in chosen}
    for name in chosen:
        own = data | {"views": {name: pair_view(results, name)}, "links": _as_links(links)}
        own |= {"view_note": "This page shows one pair; the tables lead to the others."}
        write_whole(folder / links[name], render(own, plotly, source).encode())
    index = data | {"views": {}, "links": _as_links(links)}
    index |= {"view_note": f"The 3D views of {len(chosen)} pairs have pages of their own: choose one in the tables."}
    write_whole(folder / _INDEX, render(index, plotly, source).encode())
    for path in folder.glob(_PAIR_PAGES):
        if path.name not in links.values():
            remove_stale(path)
    return folder / _INDEX, len(chosen) + 1


def _remove_folder(folder: Path) -> None:
    """Removes the pages that an earlier report wrote; a folder in which there is something else stays."""
    for path in (folder / _INDEX, folder / _PLOTLY, *folder.glob(_PAIR_PAGES)):
        remove_stale(path)
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _as_links(links: dict[str, str]) -> dict[str, str]:
    """Addresses of files: their names hold per cent signs, which an address must escape."""
    return {name: file.replace("%", "%25") for name, file in links.items()}


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


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    code: str = get_plotlyjs()
    return code


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath("assets", name).read_text(encoding="utf-8")
