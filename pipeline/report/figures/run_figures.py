"""The paper's figures of a run: plots of the run and of some of its pairs, as PNG, SVG and PDF."""

from __future__ import annotations

from pathlib import Path

from ...storage.files import remove_stale
from ..run_frames import RunResults
from . import style
from .object_plots import plot_objects
from .pair_plots import plot_overview
from .score_plots import plot_boxes, plot_distributions


def draw_figures(results: RunResults, chosen: list[str], folder: Path) -> list[Path]:
    """Write all figures, and remove those of an earlier report that this run does not have.

    The maps show the median pair of the chosen ones.

    Parameters
    ----------
    chosen : names of pairs, worst first
    folder : where the files go; created if missing
    """
    run = results.run
    median = chosen[len(chosen) // 2]
    findings = run.record.findings
    scans = [scan.pair for scan in findings.scans.scans] if findings else []
    figures = {
        "overview": plot_overview(run, results.matched, results.unmatched, median),
        "distributions": plot_distributions(results.matched),
        "box_plots": plot_boxes(results.matched, results.class_is, scans),
        "objects": plot_objects(run, results.matched),
    }
    paths = []
    for name, figure in figures.items():
        if figure is not None:
            paths += style.save(figure, folder, name)
            continue
        for kind in style.KINDS:
            remove_stale(folder / f"{name}.{kind}")
    return paths
