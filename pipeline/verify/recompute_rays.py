"""The tables of rays once more: pairs, outcomes and scores by `stages.literal`, the rest by the same code."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import INTENSITY_SCORES
from ...stages.arrays import FloatArray
from ...stages.literal import literal_method
from ...stages.literal import literal_rays as literal
from ...stages.rays import find_rays
from ..jobs.rays_job import rays_result
from .stored import Part, Skipped, StoredPair

_KEYS, _RAY = ["beam", "column"], ["outcome", "real_range_m", "sim_range_m"]
#: Rays that one side alone returned and whose distance to the other side is computed again, of a sampled pair.
_DRAWN = 200


def rays(pair: StoredPair) -> Iterator[Part | Skipped]:
    """All rays by the same code; outcomes from stored ranges, partners from all directions, scores from stored rays."""
    sensors = [pair.metadata("sensor", side)["sensor"] for side in SIDES]
    moved = pair.metadata("ground", "sim")["T_real_sim"]
    points = {side: pair.table("ground", side)[["x", "y", "z"]].to_numpy() for side in SIDES}
    T_real_sim = np.array(moved).reshape(3, 4) if moved else None
    found = find_rays(points["real"], points["sim"], (sensors[0], sensors[1]), T_real_sim)
    ground = [pair.run.read_table("ground", pair.pair_id, side) for side in SIDES]
    again = rays_result(pair.pair_id, found, ground, pair.settings.input)
    for name, table in again.tables.items():
        yield pair.part(name, table.to_pandas().drop(columns="pair_id"))
    yield pair.in_pairs({"rays_reason": found if isinstance(found, str) else None})
    stored = pair.table("rays").set_index(_KEYS)
    noise_real, noise_sim = (sensor["range_noise_m"] or 0.0 for sensor in sensors)
    noise_m = float(np.hypot(noise_real, noise_sim))
    yield from _outcomes(pair, stored, points["sim"], noise_m)
    if pair.sample.whole_sides and len(stored):
        yield _partners(pair, stored)
    yield from _scores(pair, stored)
    yield pair.in_pairs(_intensities(pair, stored))


def _outcomes(pair: StoredPair, stored: pd.DataFrame, sim: np.ndarray, noise_m: float) -> Iterator[Part]:
    """Ranges of the real returns, and what became of each ray."""
    real = pair.table("ground", "real").set_index("point_id")
    has_real = stored["real_point_id"].notna()
    hits = real.loc[stored.loc[has_real, "real_point_id"], ["x", "y", "z"]].to_numpy()
    single = np.flatnonzero(has_real & stored["sim_point_id"].isna())
    step = 1 if pair.sample.whole_sides else max(1, len(single) // _DRAWN)
    places = np.cumsum(has_real.to_numpy()) - 1
    nearest = {i: float(literal_method.distances(sim, hits[places[i]]).min()) for i in single[::step].tolist()}
    left_out = set(single.tolist()) - set(nearest)
    ranges = (
        stored[["real_range_m", "sim_range_m"]]
        .astype(object)
        .where(stored[["real_range_m", "sim_range_m"]].notna(), None)
    )
    words = [
        own if i in left_out else literal.outcome(a, b, noise_m, nearest.get(i))
        for i, (own, a, b) in enumerate(zip(stored["outcome"], *(ranges[name] for name in ranges), strict=True))
    ]
    yield Part("rays", stored, pd.DataFrame({"outcome": words}, index=stored.index), is_whole=False)
    range_m = [float(np.sqrt(x * x + y * y + z * z)) for x, y, z in hits.tolist()]
    frame = pd.DataFrame({"real_range_m": range_m}, index=stored.index[has_real])
    yield Part("rays", stored, frame, is_whole=False)


def _partners(pair: StoredPair, stored: pd.DataFrame) -> Part:
    """The simulated partner of each real return, from the directions of all."""
    real_sensor, sim_sensor = (
        literal.Sensor(own["elevation_deg"], own["azimuth_step_deg"], own["origin_height_m"], own["block_deg"])
        for own in (pair.metadata("sensor", side)["sensor"] for side in SIDES)
    )
    real, sim = (pair.table("ground", side) for side in SIDES)
    real_points, sim_points = (own[["x", "y", "z"]].to_numpy() for own in (real, sim))
    partner = literal.partners(real_points, sim_points, real_sensor, sim_sensor)
    ids = {int(real["point_id"][i]): float(sim["point_id"][j]) for i, j in partner.items()}
    is_pair = stored["real_point_id"].notna() & (stored["sim_point_id"].notna() | stored["real_point_id"].isin(ids))
    expected = [ids.get(int(own), np.nan) for own in stored.loc[is_pair, "real_point_id"]]
    frame = pd.DataFrame({"sim_point_id": expected}, index=stored.index[is_pair])
    return Part("rays", stored, frame, is_whole=False)


def _scores(pair: StoredPair, stored: pd.DataFrame) -> Iterator[Part]:
    """The scores of all rays and of each group, from the stored rays."""
    range_m = stored["real_range_m"].fillna(stored["sim_range_m"])
    column = stored.index.get_level_values("column").to_numpy()
    n_columns = pd.Series(column).groupby(stored.index.get_level_values("beam").to_numpy()).max().min() + 1
    azimuth = (column.clip(max=n_columns - 1) + 0.5) * 360.0 / n_columns - 180.0
    values = {"range": range_m, "incidence": stored["incidence_deg"], "azimuth": azimuth}
    rows = []
    for by, band in pair.table("ray_scores")[["by", "band"]].itertuples(index=False):
        if by in values:
            words = band.split()
            low, high = (float(words[1]), np.inf) if words[0] == "over" else (float(words[0]), float(words[2]))
            own = stored[(values[by] >= low) & (values[by] < high)]
        else:
            own = stored if by == "all" else stored[stored["label"] == band]
        columns = (own[name].tolist() for name in _RAY)
        rows.append({"by": by, "band": band} | literal.scores(list(zip(*columns, strict=True))))
        if by not in ("all", "azimuth"):  # rays without any return have no range, incidence or class
            rows[-1]["rays_drop_f1"] = None
    whole = literal.scores(list(zip(*(stored[name].tolist() for name in _RAY), strict=True)))
    yield pair.part("ray_scores", pd.DataFrame(rows, columns=["by", "band", *whole]))
    yield pair.in_pairs(whole if len(stored) else dict.fromkeys(whole))


def _intensities(pair: StoredPair, stored: pd.DataFrame) -> dict[str, float | str | None]:
    """Scores of intensities from the stored rays; null for all without rays."""
    names = [*(metric.column for metric in INTENSITY_SCORES), "intensity_note"]
    intensity: dict[str, FloatArray] = {}
    range_m: dict[str, FloatArray] = {}
    for side in SIDES:
        of_point = pair.table("ground", side).set_index("point_id")["intensity"].astype(float)
        intensity[side] = np.asarray(of_point.reindex(stored[f"{side}_point_id"]), dtype=np.float64)
        range_m[side] = stored[f"{side}_range_m"].to_numpy(dtype=np.float64)
    label = stored["label"].astype(object).where(stored["label"].notna(), None).tolist()
    found = literal.intensity_scores(
        stored["outcome"].tolist(),
        intensity,
        range_m,
        stored["incidence_deg"].to_numpy(dtype=float),
        label,
        has_one_scale=pair.settings.input.intensity_scale == "same",
    )
    return dict.fromkeys(names) | found if len(stored) else dict.fromkeys(names)
