"""The figures of points: one scan's overview with its fidelity map, its unmatched objects, and four chosen objects."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....schemas.columns import SIDES
from ....stages.arrays import FloatArray
from ..clouds import Cloud, PairTables
from ..colours import FATE_COLOURS, SIDE_COLOURS
from ..results import SHAPES, RunResults
from .style import (
    DOT,
    VIEW,
    box_of,
    community_colours,
    fidelity_colours,
    frame_of,
    from_above,
    metres,
    new_figure,
    save,
    shown_name,
)  # fmt: skip

_CLASSES = ("car", "vegetation", "tree", "wall")


def draw_overview(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: the objects of the real scan, both sides with matched centroids joined, the map of r_lambda."""
    tables = PairTables(results, pair_id)
    real, sim = (tables.cloud(side) for side in SIDES)
    matched = results.matched[results.matched.pair_id == pair_id]
    frame = frame_of(real.points, sim.points)
    with new_figure(11, _height(frame, 3.2)) as figure:
        axes = figure.subplots(1, 3, sharex=True, sharey=True)
        colours = community_colours(int(real.community.max()) + 1)
        axes[0].scatter(*real.points.T[:2], s=1.2, c=colours[real.community], **DOT)
        axes[0].set_title(f"(A) {real.community.max() + 1} objects of the real scan")

        for side, cloud in zip(SIDES, (real, sim), strict=True):
            axes[1].scatter(*cloud.points.T[:2], s=0.8, c=SIDE_COLOURS[side], alpha=0.5, label=side, **DOT)
        ends = np.stack([_centroids(real, matched.real_id), _centroids(sim, matched.sim_id)])
        axes[1].plot(*ends.transpose(2, 0, 1), color="black", linewidth=0.8)
        for side, centroids in zip(SIDES, ends, strict=True):
            axes[1].scatter(*centroids.T, s=13, c=SIDE_COLOURS[side], edgecolors="black", linewidths=0.6, zorder=3)
        axes[1].set_title(f"(B) real and simulated, {len(matched)} matched centroids joined")
        _point_legend(axes[1])

        values = np.full(int(real.community.max()) + 1, np.nan)
        values[matched.real_id] = matched.r_lambda.to_numpy(dtype=float)
        of_point = values[real.community]
        known = ~np.isnan(of_point)
        axes[2].scatter(*real.points[~known].T[:2], s=1.2, c="#cccccc", label="no counterpart, no score", **DOT)
        coloured = axes[2].scatter(
            *real.points[known].T[:2], s=1.2, c=of_point[known], cmap=fidelity_colours(), vmin=0, vmax=1, **DOT
        )
        axes[2].set_title("(C) structural fidelity of the real objects")
        _point_legend(axes[2])
        bar = axes[2].inset_axes((1.03, 0, 0.04, 1))
        figure.colorbar(coloured, cax=bar, label="r_lambda (0 faithful, 1 failed)")
        for axis in axes:
            from_above(axis, frame)
        figure.suptitle(f"pair {shown_name(pair_id)}", fontsize=10)
        return save(figure, folder, "overview")


def draw_unmatched(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: left both sides, right the objects that only one side has."""
    tables = PairTables(results, pair_id)
    clouds = {side: tables.cloud(side) for side in SIDES}
    alone = results.unmatched[results.unmatched.pair_id == pair_id]
    frame = frame_of(*(cloud.points for cloud in clouds.values()))
    with new_figure(9, _height(frame, 4.0)) as figure:
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for side, cloud in clouds.items():
            axes[0].scatter(*cloud.points.T[:2], s=0.8, c=SIDE_COLOURS[side], alpha=0.5, label=side, **DOT)
        axes[0].set_title("all objects")
        for cloud in clouds.values():
            axes[1].scatter(*cloud.points.T[:2], s=0.4, c="#dddddd", **DOT)
        for side, fate in zip(SIDES, ("missing", "hallucinated"), strict=True):
            ids = alone[alone.status == fate].community_id
            points = clouds[side].points[np.isin(clouds[side].community, ids)]
            label = f"{len(ids)} {fate} ({side} only)"
            axes[1].scatter(*points.T[:2], s=1.5, c=FATE_COLOURS[fate], label=label, **DOT)
        median_m = f", median range {alone.range_m.median():.0f} m" if len(alone) else ""
        axes[1].set_title(f"unmatched objects{median_m}")
        for axis in axes:
            from_above(axis, frame)
            _point_legend(axis)
        figure.suptitle(f"pair {shown_name(pair_id)}", fontsize=10)
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
        for place, (class_name, index) in enumerate(chosen):
            row = results.matched.iloc[index].to_dict()
            tables = PairTables(results, row["pair_id"])
            members = []
            for side in SIDES:
                cloud = tables.cloud(side)
                members.append(cloud.points[cloud.community == row[f"{side}_id"]])
            corner, size = box_of(np.concatenate(members))
            for level, (side, points) in enumerate(zip(SIDES, members, strict=True)):
                axis = figure.add_subplot(grid[level, place], projection="3d", **VIEW)
                axis.scatter(*(points - corner).T, s=1.5, c=SIDE_COLOURS[side], **DOT)
                metres(axis, size, zoom=0.87)
                axis.set_title(f"{side}, {len(points):,} points", pad=-4, y=1.0, fontsize=8)
            words = figure.add_subplot(grid[2, place])
            words.set_axis_off()
            words.text(
                0.5,
                1,
                f"({'abcd'[place]}) {shown_name(class_name)}, {row['range_m']:.0f} m away\n"
                f"CDC {row['cdc']:.2f}   r_lambda {row['r_lambda']:.2f}\n"
                f"r_gap {row['r_gap']:.3f}   nodes {row['n_keep']:,}\n"
                f"pair {shown_name(row['pair_id'])}, object {row['real_id']}",
                ha="center",
                va="top",
                fontsize=8.5,
            )
        return save(figure, folder, "objects")


def choose_objects(results: RunResults) -> list[tuple[str, int]]:
    """Up to four objects to look at: of each class the one of median r_lambda among the larger half.

    Labelled runs show car, vegetation, tree and wall, as the paper does, where they occur, then the most frequent other
    labels; others show the shape classes, then the largest objects.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    if results.class_is == "label":
        frequent = scored.group.value_counts().index.tolist()
        classes = [name for name in _CLASSES if name in frequent]
        classes += [name for name in frequent if name not in classes]
    else:
        classes = [name for name in SHAPES if (scored.group == name).any()]
    chosen = []
    for name in classes[:4]:
        rows = scored[scored.group == name]
        large = rows[rows.n_keep >= rows.n_keep.median()].sort_values("r_lambda", kind="stable")
        chosen.append((str(name), int(large.index[len(large) // 2])))
    taken = {index for _, index in chosen}
    for index in scored.sort_values("n_keep", ascending=False, kind="stable").index:
        if len(chosen) < 4 and index not in taken:
            chosen.append((str(scored.group[index]), int(index)))
    return chosen


def _centroids(cloud: Cloud, ids: Any) -> FloatArray:
    """(m, 2) means of the points of each object, seen from above."""
    return np.array([cloud.points[cloud.community == i, :2].mean(axis=0) for i in ids]).reshape(-1, 2)


def _height(frame: FloatArray, panel_width_in: float) -> float:
    """Inches of a figure whose panels are as wide as given, with room for titles and legends."""
    width, height = frame[1] - frame[0]
    return float(np.clip(panel_width_in * height / width, 1.5, 6)) + 1.25


def _point_legend(axis: Any) -> None:
    """A legend a fixed way under the axis, clear of its label, with dots that can be seen."""
    legend = axis.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.3, ncols=3, handletextpad=0.1)
    for handle in legend.legend_handles:
        handle.set(sizes=[22], alpha=1)
