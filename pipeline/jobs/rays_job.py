"""Stage rays: what each ray of the real sensor returned on both sides, and scores by range, incidence and class."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import scores_of
from ...stages.arrays import BoolArray, transform_of
from ...stages.clean import seen_from
from ...stages.intensity import score_intensity
from ...stages.rays import (
    AZIMUTH_EDGES_DEG,
    INCIDENCE_EDGES_DEG,
    OUTCOMES,
    RANGE_EDGES_M,
    Rays,
    find_rays,
    score_rays,
)
from ...stages.sensor_description import SensorDescription
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Metadata, Stage
from .points_job import column, coordinates


def make_rays(inputs: Inputs) -> JobResult:
    """Pair the rays of both sides and score them."""
    tables = [inputs.table("ground", side) for side in SIDES]
    settings = inputs.settings.input
    if settings.voxel_m is not None:
        return _result(inputs, f"scans thinned by input.voxel_m={settings.voxel_m:g}", tables)
    real, sim = map(coordinates, tables)
    sensors = [SensorDescription(**inputs.metadata("sensor", side)["sensor"]) for side in SIDES]
    moved = inputs.metadata("ground", "sim")["T_real_sim"]
    T_real_sim = transform_of(moved)
    position = settings.sensor_position
    if position is not None:
        real = real - position
        sim = sim - position
        T_real_sim = seen_from(position, T_real_sim)
    with inputs.step("rays"):
        rays = find_rays(real, sim, (sensors[0], sensors[1]), T_real_sim)
    with inputs.step("intensity"):
        return _result(inputs, rays, tables)


def _result(inputs: Inputs, rays: Rays | str, ground: Sequence[pa.Table]) -> JobResult:
    """One row per ray, and one of scores for each group of rays; empty tables if there is a reason instead of rays.

    Parameters
    ----------
    ground : the table of each side, whose rows the returns are
    """
    of_pair: Metadata = dict.fromkeys(scores_of("ray", "intensity"))
    of_pair |= {"rays_reason": None, "intensity_note": None}
    if isinstance(rays, str):
        of_pair["rays_reason"] = rays
        tables = {name: inputs.rows(name, []) for name in ("rays", "ray_scores")}
        return JobResult(tables, {OF_PAIR: of_pair})
    table = inputs.columns("rays", _columns(rays, ground))
    label = table.column("label").combine_chunks()
    intensity = []
    for points in ground:
        has_none = points["intensity"].null_count == len(points)
        intensity.append(None if has_none else column(points, "intensity"))
    classes = np.array(label.dictionary_encode().indices.fill_null(-1))
    one_scale = inputs.settings.input.intensity_scale == "same"
    of_pair |= score_rays(rays)
    of_pair |= score_intensity(rays, intensity, classes, has_one_scale=one_scale)
    scores = []
    for by, band, is_in in _groups(rays, label):
        row = {"by": by, "band": band} | score_rays(rays, is_in)
        if by in ("range", "incidence", "class"):  # which rays without any return do not have
            row["rays_drop_f1"] = None
        scores.append(row)
    tables = {"rays": table, "ray_scores": inputs.rows("ray_scores", scores)}
    return JobResult(tables, {OF_PAIR: of_pair})


def _columns(rays: Rays, ground: Sequence[pa.Table]) -> Row:
    """One row per ray, with the class of the real return, else of the simulated one."""
    import pyarrow.compute as pc

    ids = []
    labels = []
    for points, rows in zip(ground, (rays.real_row, rays.sim_row), strict=True):
        returned = pa.array(rows, mask=rows < 0)
        ids.append(points.column("point_id").combine_chunks().take(returned))
        labels.append(points.column("label").combine_chunks().take(returned))
    return {
        "beam": rays.beam,
        "column": rays.column,
        "real_point_id": ids[0],
        "sim_point_id": ids[1],
        "real_range_m": rays.real_range_m,
        "sim_range_m": rays.sim_range_m,
        "outcome": pa.array(OUTCOMES).take(pa.array(rays.outcome)),
        "incidence_deg": rays.incidence_deg,
        "label": pc.if_else(pa.array(rays.real_row >= 0), *labels).cast(pa.string()),
    }


def _groups(rays: Rays, label: pa.Array) -> Iterator[tuple[str, str, BoolArray]]:
    """Kind and name of each group of rays that has any, and which rays it has."""
    import pyarrow.compute as pc

    yield "all", "", np.ones(len(rays.beam), dtype=np.bool_)
    range_m = np.where(np.isnan(rays.real_range_m), rays.sim_range_m, rays.real_range_m)
    for by, values, edges, unit in (
        ("range", range_m, (*RANGE_EDGES_M, np.inf), "m"),
        ("incidence", rays.incidence_deg, (*INCIDENCE_EDGES_DEG, np.inf), "degrees"),
        ("azimuth", rays.azimuth_deg, AZIMUTH_EDGES_DEG, "degrees"),
    ):
        for low, high in pairwise(edges):
            is_in = (values >= low) & (values < high)
            if is_in.any():
                band = f"{low:g} to {high:g}" if high < np.inf else f"over {low:g}"
                yield by, f"{band} {unit}", is_in
    for name in sorted(set(label.to_pylist()) - {None}):
        yield "class", name, np.array(pc.equal(label, name).fill_null(False))


STAGE = Stage(
    name="rays",
    version=3,
    takes={"ground": ("point_id", "x", "y", "z", "intensity", "label"), "sensor": ()},
    gives=("rays", "ray_scores"),
    settings=("input",),
    grain=Grain.PAIR,
    make=make_rays,
)
