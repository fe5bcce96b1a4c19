"""One pair in memory, for Python: the whole method on arrays, with results as the tables of a run."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..schemas.columns import SIDES
from ..schemas.errors import ScanError
from ..schemas.settings import Settings, parse, preset_of
from ..stages.arrays import FloatArray
from ..stages.frame_search import FrameCheck
from .datasets.pairs import ScanPair
from .datasets.readers import read_scan
from .datasets.readers.scan import Scan
from .engine.pool import one_blas_thread
from .engine.worker import run_in_memory
from .jobs import stages_under
from .pair_checks import frame_warning
from .stage import FRAMES, OF_PAIR

if TYPE_CHECKING:
    import pandas as pd

_PAIR = "pair"
_FIELDS = {"ground": "points", "graph": "edges"}  #: of `PairResult`, by table


@dataclass(frozen=True, repr=False)
class PairResult:
    """The tables of one pair as pandas frames, with the columns of `schemas.tables`.

    preset : whose objects they are, "paper" or "reference"
    summary : the pair's row of `pairs`: counts, match rate, means and standard deviations
    points, sensor, edges, communities, objects : by side, "real" and "sim"
    matching, coverage, surface, pieces, rays, ray_scores, causes, selection, metrics : of the pair;
        `causes` has the amount of every flaw, whether it is noticeable or not
    baselines : of the pair, where `metrics.baselines` names some
    seeds : of the pair, one row per seed, where `stability.seeds` is above 1
    tasks, task_objects : of the pair, where `tasks.names` names some
    """

    preset: str
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
    rays: pd.DataFrame
    ray_scores: pd.DataFrame
    causes: pd.DataFrame
    selection: pd.DataFrame
    metrics: pd.DataFrame
    baselines: pd.DataFrame | None = None
    seeds: pd.DataFrame | None = None
    tasks: pd.DataFrame | None = None
    task_objects: pd.DataFrame | None = None

    def __repr__(self) -> str:
        names = ("n_matched", "match_rate", "cdc_mean", "r_lambda_mean")
        known = [name for name in names if self.summary[name] is not None]
        scores = [f"{name} {self.summary[name]:.4g}" for name in known]
        return f"<evaluated pair, preset {self.preset}: {', '.join(scores)}>"


def evaluate_pair(
    real: ArrayLike | Scan | Path,
    sim: ArrayLike | Scan | Path,
    settings: Settings | Mapping[str, Any] | None = None,
) -> PairResult:
    """Compare a simulated scan with a real one, object by object; the same numbers as `fidpipe run`.

    Parameters
    ----------
    real, sim : (n, 3) points, metres, in the real sensor's frame (z up), of any real number type;
        computed with as float64. NaN and infinite points, and the masked ones of a masked array,
        are dropped. A fourth column is the intensity, as in KITTI. Also a `Scan`, or the path of a
        scan file of any format that `read_scan` opens
    settings : by default those of the paper; or some of them by group, such as {"graph": {"k":
        60}}; {"preset": "reference"} fixes the objects on the real side

    Warns
    -----
    UserWarning
        The simulated scan seems to be in another frame: mirrored, rotated, shifted
        (`stages.frame_search`). Or a side holds rays without a return, second returns, two sweeps,
        or is not in its sensor's frame. If the warning names 12 numbers of `T_real_sim` = [R | t],
        pass `sim @ R.T + t`.

    Raises
    ------
    ScanError
        An array is not of shape (n, 3) or (n, 4), or its values are not real numbers (complex,
        boolean, text, objects); or a file cannot be read.
    StageError
        A stage fails, for example because fewer than 8 object points are left.

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
    settings = settings if isinstance(settings, Settings) else parse(dict(settings or {}))
    scans = {"real": _scan("real", real, settings), "sim": _scan("sim", sim, settings)}
    with one_blas_thread():
        pair = ScanPair(_PAIR, None, None)
        tables, outputs = run_in_memory(
            stages_under(settings), settings, pair=pair, scans=scans
        )
    check = outputs["sensor", "sim"][FRAMES]
    if check is not None and check["is_suspect"]:
        warnings.warn(frame_warning(FrameCheck(**check)), stacklevel=2)
    for side in SIDES:
        for text in outputs["sensor", side]["sensor"]["doubts"].values():
            warnings.warn(f"{side} side: {text}", stacklevel=2)
    summary: dict[str, Any] = {"pair_id": _PAIR, "status": "scored"}
    for metadata in outputs.values():
        summary |= metadata.get(OF_PAIR, {})
    frames: dict[str, Any] = {}
    for (name, side), table in tables.items():
        frame = table.to_pandas()
        if side:
            frames.setdefault(_FIELDS.get(name, name), {})[side] = frame
        else:
            frames[name] = frame
    return PairResult(preset=preset_of(settings), summary=summary, **frames)


def _scan(name: str, source: ArrayLike | Scan | Path, settings: Settings) -> Scan:
    if isinstance(source, Scan):
        return replace(source, points=_numbers(name, source.points)[:, :3])
    if isinstance(source, str | Path):
        return read_scan(source, settings.input.columns_of(name))
    columns = _numbers(name, source)
    return Scan(columns[:, :3], intensity=columns[:, 3] if columns.shape[1] == 4 else None)


def _numbers(name: str, points: ArrayLike) -> FloatArray:
    try:
        array = np.asanyarray(points)
    except ValueError as error:
        raise ScanError(
            f"{name}: expected numbers of shape (n, 3), got rows of unequal lengths",
        ) from error
    if array.ndim != 2 or array.shape[1] not in (3, 4):
        raise ScanError(
            f"{name}: expected an array of shape (n, 3), or (n, 4) with the intensity, got {array.shape}",
        )
    if array.dtype.kind not in "fiu":
        raise ScanError(f"{name}: expected real numbers, got {array.dtype} values")
    with np.errstate(over="ignore"):  # what float64 does not hold is infinite, and dropped
        metres = array.astype(np.float64, copy=False)
    return np.asarray(np.ma.filled(metres, np.nan))
