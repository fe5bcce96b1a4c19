"""A finished run for Python users: its tables as pandas frames, its objects, and plots of a pair and of an object."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .datasets.pairs import local_folder
from .results.finished import FinishedRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Run(FinishedRun):
    """A finished run, as `open_run` returns it: tables as pandas frames or as Arrow, objects, and plots.

    Each file is checked as it is read. A plot is a matplotlib figure: notebooks show it, `savefig` writes it.

    Examples
    --------
    >>> import fidpipe
    >>> run = fidpipe.open_run("runs/streets")  # doctest: +SKIP
    >>> run.metrics.groupby("pair_id").r_lambda.median()  # doctest: +SKIP
    >>> run.points("0003", "sim").query("community_id == 7")[["x", "y", "z"]]  # doctest: +SKIP
    >>> run.table("coverage")  # as Arrow  # doctest: +SKIP
    >>> run.plot_object("0003", 7).savefig("object.png")  # doctest: +SKIP
    """

    def plot_object(self, pair_id: str, name: str | int, ax: Axes | None = None) -> Figure:
        """Plot an object on both sides in one box, with its scores; other points in the box are grey.

        Parameters
        ----------
        pair_id : name of the pair
        name : 7 or "real:7" for the real object 7 and its partner, "sim:7" for the simulated one
        ax : matplotlib axes in 3D to draw into; by default those of a new figure
        """
        from .report.figures.plots import plot_object

        return plot_object(self, pair_id, str(name), ax)

    def plot_pieces(self, pair_id: str, ax: Axes | None = None) -> Figure:
        """Plot a pair from above: missing and invented pieces in colour, with the numbers of the largest ones.

        Parameters
        ----------
        ax : matplotlib axes to draw into; by default those of a new figure
        """
        from .report.figures.plots import plot_pieces

        return plot_pieces(self, pair_id, ax)

    def plot_range_image(self, pair_id: str, ax: Axes | None = None) -> Figure:
        """Plot the outcomes of the rays of a pair over azimuth and beam.

        Parameters
        ----------
        ax : matplotlib axes to draw into; by default those of a new figure
        """
        from .report.figures.plots import plot_range_image

        return plot_range_image(self, pair_id, ax)


def open_run(folder: Path | str) -> Run:
    """The folder of a finished run, its tables as pandas frames: `pairs`, `objects`, `metrics`, `points`, `edges`.

    Parameters
    ----------
    folder : as `fidpipe run` wrote it, or a URL such as s3://bucket/runs/x

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, or its table of pairs is damaged.
    """
    return Run(local_folder(str(folder)))
