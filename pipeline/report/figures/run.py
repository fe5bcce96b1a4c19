"""The paper's figures of a run, each as PNG and SVG: scores over all objects, and points of one scan.

Leaves to others: the drawing (`figures_scores`, `figures_scan`), how it looks (`figure_style`).
"""

from __future__ import annotations

from pathlib import Path

from ...storage.files import remove_stale
from ..results import RunResults
from .scan import draw_objects, draw_overview, draw_unmatched
from .scores import draw_boxes, draw_distributions
from .style import KINDS

NAMES = ("overview", "unmatched", "distributions", "box_plots", "objects")


def draw_figures(results: RunResults, chosen: list[str], folder: Path) -> list[Path]:
    """Draws all figures; those of one scan show the pair in the middle of the order from worst to best.

    A figure that is not drawn this time does not stay from an earlier report.

    Parameters
    ----------
    chosen : names of the pairs to choose that pair from, worst first
    folder : where the files go; made if it is not there
    """
    pair_id = chosen[len(chosen) // 2]
    drawn = [
        *draw_overview(results, pair_id, folder),
        *draw_unmatched(results, pair_id, folder),
        *draw_distributions(results, folder),
        *draw_boxes(results, folder),
        *draw_objects(results, folder),
    ]
    for path in (folder / f"{name}.{kind}" for name in NAMES for kind in KINDS):
        if path not in drawn:
            remove_stale(path)
    return drawn
