"""One pair in memory, for Python: the whole method on arrays, with results as the tables of a run."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from ..schemas.columns import SIDES
from ..schemas.errors import ScanError
from ..schemas.settings import Settings, parse
from ..stages.arrays import FloatArray, IntArray
from ..stages.frame_search import check_frames
from ..stages.method import Evaluation, evaluate, n_communities
from .datasets.readers import read_scan
from .datasets.readers.scan import Scan
from .engine.pool import one_blas_thread
from .jobs import causes_job, stages_under
from .jobs.communities_job import communities_result
from .jobs.coverage_job import coverage_result
from .jobs.graph_job import graph_result
from .jobs.ground_job import ground_result
from .jobs.matching_job import matching_result
from .jobs.metrics_job import metrics_result
from .jobs.pieces_job import pieces_result
from .jobs.rays_job import rays_result
from .jobs.selection_job import selection_result
from .jobs.sensor_job import sensor_result
from .jobs.surface_job import surface_result
from .pair_checks import frame_warning
from .stage import OF_PAIR, Inputs, JobResult, Metadata
from .storage.table_files import plain_metadata

if TYPE_CHECKING:
    import pandas as pd

_PAIR = "pair"
_FIELDS = {"ground": "points", "graph": "edges"}  #: of `PairResult`, by table


@dataclass(frozen=True, repr=False)
class PairResult:
    """The tables of one pair as pandas frames, with the columns of `schemas.tables`.

    summary : the pair's row of `pairs`: counts, match rate, means and standard deviations
    points, sensor, edges, communities, objects : by side, "real" and "sim"
    matching, coverage, surface, pieces, rays, ray_scores, causes, selection, metrics : of the pair
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
    rays: pd.DataFrame
    ray_scores: pd.DataFrame
    causes: pd.DataFrame
    selection: pd.DataFrame
    metrics: pd.DataFrame
    baselines: pd.DataFrame | None = None
    seeds: pd.DataFrame | None = None

    def __repr__(self) -> str:
        names = ("n_matched", "n_missing", "n_hallucinated", "match_rate", "cdc_mean", "r_lambda_mean")
        known = ((name, self.summary[name]) for name in names)
        return f"<evaluated pair: {', '.join(f'{name} {value:.4g}' for name, value in known if value is not None)}>"


def evaluate_pair(
    real: ArrayLike | Scan | Path, sim: ArrayLike | Scan | Path, settings: Settings | Mapping[str, Any] | None = None
) -> PairResult:
    """Compare a simulated scan with a real one, object by object; the same numbers as `fidpipe run`.

    Parameters
    ----------
    real, sim : (n, 3) points, metres, in the real sensor's frame (z up), of any real number type; computed with as
        float64. NaN and infinite points, and the masked ones of a masked array, are dropped. A fourth column is the
        intensity, as in KITTI. Also a `Scan`, or the path of a scan file of any format that `read_scan` opens
    settings : by default those of the paper; or some of them by group, such as {"graph": {"k": 60}};
        {"preset": "reference"} fixes the objects on the real side

    Warns
    -----
    UserWarning
        The simulated scan seems to be in another frame: mirrored, rotated, shifted (`stages.frame_search`).
        If the warning names 12 numbers of `T_real_sim` = [R | t], pass `sim @ R.T + t`.

    Raises
    ------
    ScanError
        An array is not of shape (n, 3) or (n, 4), or its values are not real numbers (complex, boolean, text, objects);
        or a file cannot be read.
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
    check = check_frames(scans["real"].points, scans["sim"].points, settings.input)
    if check and check.is_suspect:
        warnings.warn(frame_warning(check), stacklevel=2)
    with one_blas_thread():
        found = evaluate(scans["real"].points, scans["sim"].points, settings)
        tables, metadata = _results(found, scans, settings)
        for stage in stages_under(settings):
            if stage.is_extra or stage is causes_job.STAGE:
                result = stage.make(Inputs(pair_id=_PAIR, part="", settings=settings, tables=tables, outputs=metadata))
                tables |= {(name, ""): partial(_whole, rows) for name, rows in result.tables.items()}
                metadata |= {(name, ""): result.metadata for name in result.tables}
    summary: dict[str, Any] = {"pair_id": _PAIR, "status": "scored"}
    for own in metadata.values():
        summary |= plain_metadata(own.get(OF_PAIR, {}))
    frames: dict[str, Any] = {}
    for (name, side), table in tables.items():
        if side:
            frames.setdefault(_FIELDS.get(name, name), {})[side] = table().to_pandas()
        else:
            frames[name] = table().to_pandas()
    return PairResult(summary=summary, **frames)


def _results(
    found: Evaluation, scans: Mapping[str, Scan], settings: Settings
) -> tuple[dict[tuple[str, str], Callable[[], pa.Table]], dict[tuple[str, str], Metadata]]:
    """Tables and metadata of an evaluation, by table and side, as the jobs of a run return them."""
    results: list[tuple[str, JobResult]] = []
    ids: list[IntArray] = []
    sides = found.real, found.sim
    for side, own in zip(SIDES, sides, strict=True):
        ids.append(own.clean.point_ids[~own.cut.is_ground])
        results += [
            (side, ground_result(_PAIR, side, scans[side], own.clean, own.cut)),
            (side, sensor_result(_PAIR, side, own.sensor)),
            (side, graph_result(_PAIR, side, ids[-1], own.scan.edges)),
            (side, communities_result(_PAIR, side, ids[-1], own.scan)),
        ]
    matching, scored = found.scores.matching, found.scores.objects
    n_real, n_sim = (own.scan.objects.n_points for own in sides)
    names = ("real_id", "sim_id", "centroid_distance_m")
    values = zip(matching.real_ids.tolist(), matching.sim_ids.tolist(), matching.distance_m.tolist(), strict=True)
    rows = [dict(zip(names, own, strict=True)) for own in values]
    members = [
        [own_ids[own.scan.labels == row[f"{side}_id"]] for row in rows]
        for side, own, own_ids in zip(SIDES, sides, ids, strict=True)
    ]
    sizes = [
        (len(real), len(sim), len(own.selection.real_nodes)) for real, sim, own in zip(*members, scored, strict=True)
    ]
    ground = [own.tables["ground"] for _, own in results if "ground" in own.tables]
    results += [
        ("", matching_result(_PAIR, matching, n_real, n_sim)),
        ("", coverage_result(_PAIR, (found.real.coverage, found.sim.coverage))),
        ("", surface_result(_PAIR, found.surface)),
        ("", pieces_result(_PAIR, found.pieces)),
        ("", rays_result(_PAIR, found.rays, ground, settings.input)),
        ("", selection_result(_PAIR, zip(rows, *members, [own.selection for own in scored], strict=True))),
        ("", metrics_result(_PAIR, zip(rows, sizes, [own.scores for own in scored], strict=True))),
    ]
    tables: dict[tuple[str, str], Callable[[], pa.Table]] = {}
    metadata: dict[tuple[str, str], Metadata] = {}
    for side, result in results:
        tables |= {(name, side): partial(_whole, rows) for name, rows in result.tables.items()}
        metadata |= {(name, side): result.metadata for name in result.tables}
    metadata["metrics", ""] = {OF_PAIR: found.scores.summary | n_communities(found.scores.summary)}
    return tables, metadata


def _whole(table: pa.Table) -> pa.Table:
    return table


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
        raise ScanError(f"{name}: expected numbers of shape (n, 3), got rows of unequal lengths") from error
    if array.ndim != 2 or array.shape[1] not in (3, 4):
        hint = f"; pass {name}[:, :3]" if array.ndim == 2 and array.shape[1] > 4 else ""
        raise ScanError(
            f"{name}: expected an array of shape (n, 3), or (n, 4) with the intensity, got {array.shape}{hint}"
        )
    if array.dtype.kind not in "fiu":
        convert = ".real" if array.dtype.kind == "c" else ".astype(float)"
        raise ScanError(f"{name}: expected real numbers, got {array.dtype} values; convert them with {name}{convert}")
    with np.errstate(over="ignore"):  # what float64 does not hold is infinite, and dropped
        metres = array.astype(np.float64, copy=False)
    return np.asarray(np.ma.filled(metres, np.nan))
