"""One pair in memory, for Python: the same jobs as the command's, on arrays instead of files."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..schemas.columns import SIDES
from ..schemas.errors import ScanError, StageError
from ..schemas.settings import Settings, parse
from ..stages.arrays import FloatArray
from ..stages.inspect.frames import check_frames
from .datasets.pairs import ScanPair
from .datasets.readers.scan import Scan
from .engine.plan import Planner
from .engine.pool import one_blas_thread
from .engine.worker import PairTables, make_job
from .inspect.frame_checks import frame_warning
from .inspect.scan_checks import ScanContent
from .jobs import stages_under
from .stage import ROW

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class PairResult:
    """The tables of one pair as pandas frames, with the columns of `schemas.tables`.

    summary : the pair's row of `pairs`: counts, match rate, means and standard deviations
    points, sensor, edges, communities, objects : by side, "real" and "sim"
    matching, coverage, surface, pieces, selection, metrics : of the pair
    baselines : of the pair, where `metrics.baselines` names some
    seeds : of the pair, one row per seed, where `stability.seeds` is above 1
    """

    summary: dict[str, Any]
    points: dict[str, pd.DataFrame]
    sensor: dict[str, pd.DataFrame]
    edges: dict[str, pd.DataFrame]
    communities: dict[str, pd.DataFrame]
    objects: dict[str, pd.DataFrame]
    matching: pd.DataFrame
    coverage: pd.DataFrame
    surface: pd.DataFrame
    pieces: pd.DataFrame
    selection: pd.DataFrame
    metrics: pd.DataFrame
    baselines: pd.DataFrame | None = None
    seeds: pd.DataFrame | None = None


def evaluate_pair(real: ArrayLike, sim: ArrayLike, settings: Settings | Mapping[str, Any] | None = None) -> PairResult:
    """How far a simulated scan is from a real one, object by object; the same numbers as `fidpipe run`.

    Parameters
    ----------
    real, sim : (n, 3) points, metres, in the real sensor's frame (z up), of any real number type; computed with as
        float64. NaN and infinite points, and the masked ones of a masked array, are dropped
    settings : by default those of the paper; or some of them by group, such as {"graph": {"k": 60}};
        {"preset": "reference"} fixes the objects on the real side

    Warns
    -----
    UserWarning
        The simulated scan seems to lie in another frame: mirrored, turned, shifted (`stages.inspect.frames`). Where 12
        numbers of `T_real_sim` = [R | t] are named, pass `sim @ R.T + t`.

    Raises
    ------
    ScanError
        An array is not of shape (n, 3) or holds no real numbers: complex ones, truth values, text and objects are none.
    StageError
        A stage cannot go on, such as with fewer than 8 object points.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> road = np.column_stack([rng.uniform(-20, 20, (400, 2)), rng.normal(-1.7, 0.01, 400)])
    >>> houses = rng.uniform([-12, 8, -1], [12, 9, 4], (200, 3))
    >>> scan = np.vstack([road, houses])
    >>> result = evaluate_pair(scan, scan)
    >>> result.summary["match_rate"], result.metrics.status.unique().tolist()
    (1.0, ['identical'])
    >>> evaluate_pair(scan, scan[::-1], {"preset": "reference"}).summary["cdc_mean"]
    0.0
    """
    scans = {"real": Scan(_points("real", real)), "sim": Scan(_points("sim", sim))}
    settings = settings if isinstance(settings, Settings) else parse(dict(settings or {}))
    inputs = {side: ScanContent("", "", len(scan.points)) for side, scan in scans.items()}
    check = check_frames(scans["real"].points, scans["sim"].points, settings.input)
    if check and check.is_suspect:
        warnings.warn(frame_warning(check), stacklevel=2)
    plan = Planner(stages_under(settings), settings, {}).plan(ScanPair("pair", None, None), inputs)
    tables, summary = PairTables(plan, scans), dict[str, Any]()
    with one_blas_thread():
        for job in plan.jobs:
            try:
                summary = make_job(tables, job).facts.get(ROW, summary)
            except StageError as error:
                raise StageError(f"stage {job.stage.name}{', ' + job.part if job.part else ''}: {error}") from error

    def by_side(table: str) -> dict[str, pd.DataFrame]:
        return {side: frame(table, side) for side in SIDES}

    def frame(table: str, side: str = "") -> pd.DataFrame:
        rows: pd.DataFrame = tables.whole_table(table, side).to_pandas()
        return rows

    return PairResult(
        summary=summary,
        points=by_side("ground"),
        sensor=by_side("sensor"),
        edges=by_side("graph"),
        communities=by_side("communities"),
        objects=by_side("objects"),
        matching=frame("matching"),
        coverage=frame("coverage"),
        surface=frame("surface"),
        pieces=frame("pieces"),
        selection=frame("selection"),
        metrics=frame("metrics"),
        baselines=frame("baselines") if settings.metrics.baselines else None,
        seeds=frame("seeds") if settings.stability.seeds > 1 else None,
    )


def _points(name: str, points: ArrayLike) -> FloatArray:
    try:
        array = np.asanyarray(points)
    except ValueError as error:
        raise ScanError(f"{name}: rows of unequal lengths found, numbers of shape (n, 3) wanted") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise ScanError(f"{name}: an array of shape {array.shape} found, (n, 3) wanted")
    if array.dtype.kind not in "fiu":
        convert = ".real" if array.dtype.kind == "c" else ".astype(float)"
        raise ScanError(f"{name}: {array.dtype} values found, real numbers wanted; convert them with {name}{convert}")
    with np.errstate(over="ignore"):  # what float64 does not hold is infinite, and dropped
        metres = array.astype(np.float64, copy=False)
    return np.asarray(np.ma.filled(metres, np.nan))
