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
from ..stage import OF_PAIR, Inputs, JobResult, Metadata, Stage
from .points_job import column, coordinates, sensor_of


def make_rays(inputs: Inputs) -> JobResult:
    """Pair the rays of both sides and score them; empty tables and a reason if that is not possible."""
    ground = [inputs.table("ground", side) for side in SIDES]
    of_pair: Metadata = dict.fromkeys(scores_of("ray", "intensity"))
    of_pair |= {"rays_reason": None, "intensity_note": None}
    with inputs.step("rays"):
        rays = _rays(inputs, ground)
    if isinstance(rays, str):
        of_pair["rays_reason"] = rays
        tables = inputs.rows("rays", []) | inputs.rows("ray_scores", [])
        return JobResult(tables, {OF_PAIR: of_pair})
    tables = inputs.columns("rays", _columns(rays, ground))
    label = tables["rays"].column("label").combine_chunks()
    scores = score_rays(rays)
    of_pair |= scores
    rows = [{"by": "all", "band": ""} | scores]
    for by, band, is_in in _groups(rays, label):
        row = {"by": by, "band": band} | score_rays(rays, is_in)
        if by != "azimuth":  # which rays without any return do not have
            row["rays_drop_f1"] = None
        rows.append(row)
    with inputs.step("intensity"):
        of_pair |= _intensity_scores(inputs, rays, ground, label)
    return JobResult(tables | inputs.rows("ray_scores", rows), {OF_PAIR: of_pair})


def _rays(inputs: Inputs, ground: Sequence[pa.Table]) -> Rays | str:
    """The rays of both sides, or the reason why there are none.

    Parameters
    ----------
    ground : the table of each side
    """
    settings = inputs.settings.input
    if settings.voxel_m is not None:
        return f"scans thinned by input.voxel_m={settings.voxel_m:g}"
    real, sim = map(coordinates, ground)
    T_real_sim = transform_of(inputs.metadata("ground", "sim")["T_real_sim"])
    position = settings.sensor_position
    if position is not None:
        real = real - position
        sim = sim - position
        T_real_sim = seen_from(position, T_real_sim)
    sensors = sensor_of(inputs, "real"), sensor_of(inputs, "sim")
    return find_rays(real, sim, sensors, T_real_sim)


def _intensity_scores(
    inputs: Inputs, rays: Rays, ground: Sequence[pa.Table], label: pa.Array
) -> Metadata:
    intensity = []
    for points in ground:
        has_none = points["intensity"].null_count == len(points)
        intensity.append(None if has_none else column(points, "intensity"))
    classes = np.array(label.dictionary_encode().indices.fill_null(-1))
    one_scale = inputs.settings.input.intensity_scale == "same"
    return score_intensity(rays, intensity, classes, has_one_scale=one_scale)


def _columns(rays: Rays, ground: Sequence[pa.Table]) -> Row:
    """One row per ray, with the class of the real return, else of the simulated one."""
    import pyarrow.compute as pc

    columns = dict(vars(rays))
    labels = []
    for side, points in zip(SIDES, ground, strict=True):
        rows = columns[f"{side}_row"]
        returned = points.select(("point_id", "label")).take(pa.array(rows, mask=rows < 0))
        columns[f"{side}_point_id"] = returned["point_id"]
        labels.append(returned["label"])
    columns["outcome"] = pa.array(OUTCOMES).take(pa.array(rays.outcome))
    has_real = pa.array(rays.real_row >= 0)
    columns["label"] = pc.if_else(has_real, *labels).cast(pa.string())
    return columns


def _groups(rays: Rays, label: pa.Array) -> Iterator[tuple[str, str, BoolArray]]:
    """Kind and name of each group of rays that has any, and which rays it has."""
    import pyarrow.compute as pc

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
    takes=("ground", "sensor"),
    gives=("rays", "ray_scores"),
    settings=("input",),
    make=make_rays,
)
