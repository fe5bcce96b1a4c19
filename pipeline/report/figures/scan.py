"""The figures of points: one scan's overview with its fidelity map, its unmatched objects, and four chosen objects."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....schemas.columns import SIDES
from ....stages.arrays import FloatArray
from ..aggregates import axis_title
from ..clouds import PairTables
from ..colours import FATE_COLOURS, SIDE_COLOURS
from ..results import SHAPES, RunResults
from .style import (
    VIEW,
    box_of,
    community_colours,
    dots,
    fidelity_colours,
    frame_of,
    from_above,
    metres,
    new_figure,
    save,
    shown_name,
)

_CLASSES = ("car", "vegetation", "tree", "wall")


def draw_overview(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: the objects of the real scan, both sides with matched centroids joined, the map of r_lambda."""
    tables = PairTables(results, pair_id)
    real, matched = tables.clouds["real"], tables.matched
    n_objects = int(real.community.max()) + 1
    frame = frame_of(*(cloud.points for cloud in tables.clouds.values()))
    with new_figure(11, _height(frame, 3.2), f"pair {shown_name(pair_id)}") as figure:
        objects, sides, fidelity = figure.subplots(1, 3, sharex=True, sharey=True)
        dots(objects, real.points, 1.2, community_colours(n_objects)[real.community])
        objects.set_title(f"(A) {n_objects} objects of the real scan")

        _draw_sides(sides, tables)
        ends = [
            np.array([cloud.members(i)[:, :2].mean(axis=0) for i in matched[f"{side}_id"]]).reshape(-1, 2)
            for side, cloud in tables.clouds.items()
        ]
        sides.plot(*np.stack(ends).transpose(2, 0, 1), color="black", linewidth=0.8)
        for side, centroids in zip(SIDES, ends, strict=True):
            sides.scatter(*centroids.T, s=13, c=SIDE_COLOURS[side], edgecolors="black", linewidths=0.6, zorder=3)
        sides.set_title(f"(B) real and simulated, {len(matched)} matched centroids joined")

        values = np.full(n_objects, np.nan)
        values[matched.real_id] = matched.r_lambda.to_numpy(dtype=float)
        of_point = values[real.community]
        known = ~np.isnan(of_point)
        dots(fidelity, real.points[~known], 1.2, "#cccccc", label="no counterpart, no score")
        coloured = dots(fidelity, real.points[known], 1.2, of_point[known], cmap=fidelity_colours(), vmin=0, vmax=1)
        fidelity.set_title("(C) structural fidelity of the real objects")
        figure.colorbar(coloured, cax=fidelity.inset_axes((1.03, 0, 0.04, 1)), label=axis_title("r_lambda"))
        for axis in (objects, sides, fidelity):
            from_above(axis, frame)
        return save(figure, folder, "overview")


def draw_unmatched(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: left both sides, right the objects that only one side has."""
    tables = PairTables(results, pair_id)
    alone = tables.unmatched
    frame = frame_of(*(cloud.points for cloud in tables.clouds.values()))
    with new_figure(9, _height(frame, 4.0), f"pair {shown_name(pair_id)}") as figure:
        sides, unmatched = figure.subplots(1, 2, sharex=True, sharey=True)
        _draw_sides(sides, tables)
        sides.set_title("all objects")
        for cloud in tables.clouds.values():
            dots(unmatched, cloud.points, 0.4, "#dddddd")
        for (side, cloud), fate in zip(tables.clouds.items(), ("missing", "hallucinated"), strict=True):
            ids = alone[alone.status == fate].community_id
            points = cloud.points[np.isin(cloud.community, ids)]
            dots(unmatched, points, 1.5, FATE_COLOURS[fate], label=f"{len(ids)} {fate} ({side} only)")
        median_m = f", median range {alone.range_m.median():.0f} m" if len(alone) else ""
        unmatched.set_title(f"unmatched objects{median_m}")
        for axis in (sides, unmatched):
            from_above(axis, frame)
        return save(figure, folder, "unmatched")


def draw_objects(results: RunResults, folder: Any) -> Any:
    """Four chosen objects, real above simulated, with their CDC and r_lambda; metres from the object's corner.

    Where no object has a spectral score there is no such figure.
    """
    chosen = choose_objects(results)
    if not chosen:
        return []
    with new_figure(2.9 * max(2, len(chosen)), 5.8) as figure:
        grid = figure.add_gridspec(3, len(chosen), height_ratios=(1, 1, 0.3))
        for place, index in enumerate(chosen):
            row = results.matched.iloc[index]
            clouds = PairTables(results, row.pair_id).clouds
            members = {side: cloud.members(row[f"{side}_id"]) for side, cloud in clouds.items()}
            corner, size = box_of(np.concatenate(list(members.values())))
            for level, (side, points) in enumerate(members.items()):
                axis = figure.add_subplot(grid[level, place], projection="3d", **VIEW)
                dots(axis, points - corner, 1.5, SIDE_COLOURS[side])
                metres(axis, size, zoom=0.87)
                axis.set_title(f"{side}, {len(points):,} points", pad=-4, y=1.0, fontsize=8)
            words = (
                f"({'abcd'[place]}) {shown_name(row.group)}, {row.range_m:.0f} m away\n"
                f"CDC {row.cdc:.2f}   r_lambda {row.r_lambda:.2f}\n"
                f"r_gap {row.r_gap:.3f}   nodes {row.n_keep:,}\n"
                f"pair {shown_name(row.pair_id)}, object {row.real_id}"
            )
            axis = figure.add_subplot(grid[2, place])
            axis.set_axis_off()
            axis.text(0.5, 1, words, ha="center", va="top", fontsize=8.5)
        return save(figure, folder, "objects")


def choose_objects(results: RunResults) -> list[int]:
    """Up to four objects to look at, as places in `matched`: of each class that of median r_lambda in the larger half.

    Labelled runs show car, vegetation, tree and wall, as the paper does, where they occur, then the most frequent other
    labels; others show the shape classes, then the largest objects.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    frequent = scored.group.value_counts().index
    first = _CLASSES if results.class_is == "class" else SHAPES
    classes = [name for name in first if name in frequent]
    if results.class_is == "class":
        classes += [name for name in frequent if name not in classes]
    chosen = []
    for name in classes[:4]:
        rows = scored[scored.group == name]
        large = rows[rows.n_keep >= rows.n_keep.median()].sort_values("r_lambda", kind="stable")
        chosen.append(int(large.index[len(large) // 2]))
    largest = scored.drop(chosen).sort_values("n_keep", ascending=False, kind="stable").index.tolist()
    return [*chosen, *largest][:4]


def _draw_sides(axis: Any, tables: PairTables) -> None:
    for side, cloud in tables.clouds.items():
        dots(axis, cloud.points, 0.8, SIDE_COLOURS[side], alpha=0.5, label=side)


def _height(frame: FloatArray, panel_width_in: float) -> float:
    """Inches of a figure whose panels are as wide as given, with room for titles and legends."""
    width, height = frame[1] - frame[0]
    return float(np.clip(panel_width_in * height / width, 1.5, 6)) + 1.25
