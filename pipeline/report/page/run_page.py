"""Writes the report of a run: one page, and the paper's figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...engine.progress import Reporter
from ...results.best_case import excess_over
from ...storage.files import write_whole
from ..run_frames import read_results
from .page_templates import render
from .pair_data import MOST_POINTS, pair_data
from .run_data import page_data, page_words

PAGE = "report.html"
FIGURES = "figures"
#: Number of pairs with points on a page, and those of the worst places.
MOST_VIEWS = 15


@dataclass(frozen=True)
class ReportFiles:
    """Files written: the page and the figures; and the number of pairs in 3D, and of all."""

    page: Path
    figures: list[Path]
    n_views: int
    n_pairs: int


def write_report(
    folder: Path,
    pattern: str | None = None,
    *,
    out: Path | None = None,
    html: Path | None = None,
    best_case: Path | None = None,
    with_figures: bool = False,
) -> ReportFiles:
    """Write the page of a finished run, in place of that of an earlier report.

    Parameters
    ----------
    folder : of the run
    pattern : only pairs whose name matches are shown in 3D (shell style); the rest of the page is
        of all pairs
    out : folder that page and figures are written into; by default the run's own
    html : file of the page; by default report.html in that folder
    best_case : the run of fidpipe best-case that scores are also shown over
    with_figures : also write the paper's figures; maps are of the median of those pairs

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
    page = html or folder / PAGE
    matching = results.run.select(pattern)
    chosen = [name for name in results.pairs["pair_id"] if name in matching]
    overview = results.run.overview
    of_worst = {piece.pair_id for piece in overview.pieces} if overview else set()
    names = [name for i, name in enumerate(chosen) if i < MOST_VIEWS or name in of_worst]
    n_pairs = len(results.pairs)
    show = Reporter()
    show.start(len(names), len(names))
    views = {}
    for name in names:
        views[name] = pair_data(results, name, MOST_POINTS // len(names))
        show.advance(1, 1)
    show.stop()
    data = {**page_data(results), "views": views}
    words = page_words(results, views, excess)
    content = render("report.html", data, n_views=len(names), **words)
    write_whole(page, content.encode())
    figures = []
    if with_figures:
        figures = draw_figures(results, chosen[len(chosen) // 2], folder / FIGURES)
    return ReportFiles(page, figures, len(names), n_pairs)
