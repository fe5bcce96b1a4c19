"""The paper's figures of a run, each as PNG, SVG and PDF: scores over all objects, and the points of one scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ....schemas.columns import SIDES
from ....schemas.metric_catalogue import METRIC
from ....stages.arrays import FloatArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.statistics.typical_objects import SHAPES
from ...results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ...storage.files import remove_stale
from ..look import FATE_COLOURS, QUADRANT_COLOURS, SCORE_COLOURS, SIDE_COLOURS
from ..run_frames import FEWEST_IN_BOX, SCORES, PairFrames, RunResults, axis_title, frames_of, quadrants
from . import style

NAMES = ("overview", "coverage", "unmatched", "distributions", "box_plots", "objects")
_MOST_CLASSES = 8
_MOST_LETTERS = 70  # that fit side by side under the boxes
_UNCOVERED = (
    "(A) missing surface: {:.0f} % of the real points\nhave no simulated one within 0.3 m",
    "(B) invented surface: {:.0f} % of the simulated points\nhave no real one within 0.3 m",
)
_CLASSES = ("car", "vegetation", "tree", "wall")


def draw_figures(results: RunResults, chosen: list[str], folder: Path) -> list[Path]:
    """Draws all figures; those of one scan show the pair in the middle of the order from worst to best.

    The map of distances shows the worst pair.

    A figure that is not drawn this time does not stay from an earlier report.

    Parameters
    ----------
    chosen : names of the pairs to choose that pair from, worst first
    folder : where the files go; created if missing
    """
    pair_id = chosen[len(chosen) // 2]
    drawn = [
        *draw_overview(results, pair_id, folder),
        *draw_coverage(results, chosen[0], folder),
        *draw_unmatched(results, pair_id, folder),
        *draw_distributions(results, folder),
        *draw_boxes(results, folder),
        *draw_objects(results, folder),
    ]
    for path in (folder / f"{name}.{kind}" for name in NAMES for kind in style.KINDS):
        if path not in drawn:
            remove_stale(path)
    return drawn


def draw_overview(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: the objects of the real scan, both sides with matched centroids joined, the map of r_lambda."""
    tables = frames_of(results, pair_id)
    real, matched = tables.clouds["real"], tables.matched
    n_objects = int(real.community.max()) + 1
    values = np.full(n_objects + 1, np.nan)  # the last of points of no object, -1
    values[matched.real_id] = matched.r_lambda.to_numpy(dtype=float)
    of_point = values[real.community]
    known, ramp = ~np.isnan(of_point), {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": 1}
    panels: dict[str, list[style.Layer]] = {
        f"(A) {n_objects} objects of the real scan": [
            (real.points, 1.2, style.community_colours(n_objects + 1)[real.community], {})
        ],
        f"(B) real and simulated, {len(matched)} matched centroids joined": _both_sides(tables),
        "(C) structural fidelity of the real objects": [
            (real.points[~known], 1.2, "#cccccc", {"label": "no counterpart, no score"}),
            (real.points[known], 1.2, of_point[known], ramp),
        ],
    }
    with style.new_maps(_frame(tables), panels, _title(pair_id), label=axis_title("r_lambda")) as (figure, axes):
        ends = [
            np.array([cloud.members(i)[:, :2].mean(axis=0) for i in matched[f"{side}_id"]]).reshape(-1, 2)
            for side, cloud in tables.clouds.items()
        ]
        axes[1].plot(*np.stack(ends).transpose(2, 0, 1), color="black", linewidth=0.8)
        for side, centroids in zip(SIDES, ends, strict=True):
            look = {"edgecolors": "black", "linewidths": 0.6, "zorder": 3}
            axes[1].scatter(*centroids.T, s=13, c=SIDE_COLOURS[side], **look)
        return style.save(figure, folder, "overview")


def draw_coverage(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: the points of each side by their distance to the other one, far ones on top."""
    tables = frames_of(results, pair_id)
    pair = results.pairs.set_index("pair_id").loc[pair_id]
    is_worst = len(results.pairs) > 1 and pair_id == results.pairs.pair_id[0]
    ramp = {"cmap": style.fidelity_colours(), "vmin": 0, "vmax": COVERAGE_DISTANCES_M[-1]}
    panels: dict[str, list[style.Layer]] = {}
    for (side, cloud), words in zip(tables.clouds.items(), _UNCOVERED, strict=True):
        distance_m = tables.distances_m[side]
        order = np.argsort(distance_m, kind="stable")
        share = 100 * (1 - pair[f"covered_{side}_0p3m"])
        panels[words.format(share)] = [(cloud.points[order], 1.2, distance_m[order], ramp)]
    title, bar = f"{_title(pair_id)}{', the worst' * is_worst}", {"label": "distance to the other side (m)"}
    with style.new_maps(_frame(tables), panels, title, **bar, extend="max") as (figure, _):
        return style.save(figure, folder, "coverage")


def draw_unmatched(results: RunResults, pair_id: str, folder: Any) -> Any:
    """Seen from above: left both sides, right the objects that only one side has."""
    tables = frames_of(results, pair_id)
    alone, layers = tables.unmatched, list[style.Layer]()
    for side, fate in zip(SIDES, ("missing", "hallucinated"), strict=True):
        cloud, ids = tables.clouds[side], alone[alone.status == fate].community_id
        label = {"label": f"{len(ids)} {fate} ({side} only)"}
        layers.insert(0, (cloud.points, 0.4, "#dddddd", {}))
        layers.append((cloud.points[np.isin(cloud.community, ids)], 1.5, FATE_COLOURS[fate], label))
    median_m = f", median range {alone.range_m.median():.0f} m" if len(alone) else ""
    panels = {"all objects": _both_sides(tables), f"unmatched objects{median_m}": layers}
    with style.new_maps(_frame(tables), panels, _title(pair_id)) as (figure, _):
        return style.save(figure, folder, "unmatched")


def _title(pair_id: str) -> str:
    return f"pair {style.shown_name(pair_id)}"


def _frame(tables: PairFrames) -> FloatArray:
    return style.frame_of(*(cloud.points for cloud in tables.clouds.values()))


def _both_sides(tables: PairFrames) -> list[style.Layer]:
    look = {"alpha": 0.5}
    return [(cloud.points, 0.8, SIDE_COLOURS[side], look | {"label": side}) for side, cloud in tables.clouds.items()]


def draw_objects(results: RunResults, folder: Any) -> Any:
    """Four chosen objects, real above simulated, with their CDC and r_lambda; metres from the object's corner.

    Where no object has a spectral score there is no such figure.
    """
    chosen = _choose_objects(results)
    if not chosen:
        return []
    with style.new_figure(2.9 * max(2, len(chosen)), 5.8) as figure:
        figure.get_layout_engine().set(rect=(0, 0, 0.975, 1))  # which does not see the label of z
        grid = figure.add_gridspec(3, len(chosen), height_ratios=(1, 1, 0.3))
        for place, index in enumerate(chosen):
            row = results.matched.iloc[index]
            clouds = frames_of(results, row.pair_id).clouds
            members = {side: cloud.members(row[f"{side}_id"]) for side, cloud in clouds.items()}
            corner, size = style.box_of(np.concatenate(list(members.values())))
            for level, (side, points) in enumerate(members.items()):
                axis = figure.add_subplot(grid[level, place], projection="3d", **style.VIEW)
                style.dots(axis, points - corner, 1.5, SIDE_COLOURS[side])
                style.metres(axis, size, zoom=0.87)
                axis.set_title(f"{side}, {len(points):,} points", pad=-4, y=1.0, fontsize=8)
            words = (
                f"({'abcd'[place]}) {style.shown_name(row.group)}, {row.range_m:.0f} m away\n"
                f"CDC {row.cdc:.2f}   r_lambda {row.r_lambda:.2f}\n"
                f"r_gap {row.r_gap:.3f}   nodes {row.n_keep:,}\n"
                f"pair {style.shown_name(row.pair_id)}, object {row.real_id}"
            )
            axis = figure.add_subplot(grid[2, place])
            axis.set_axis_off()
            axis.text(0.5, 1, words, ha="center", va="top", fontsize=8.5)
        return style.save(figure, folder, "objects")


def draw_distributions(results: RunResults, folder: Any) -> Any:
    """Histograms of r_lambda and CDC over all matched objects, and one against the other with the four quadrants."""
    with style.new_figure(10, 3.3) as figure:
        *axes, cross = figure.subplots(1, 3, width_ratios=(1, 1, 1.35))
        for axis, score in zip(axes, SCORES, strict=True):
            values = results.matched[score].dropna().to_numpy(dtype=float)
            high, shares = METRIC[score].high, np.full(len(values), 1 / max(1, len(values)))
            look = {"bins": 25, "range": (0, high), "histtype": "stepfilled", "alpha": 0.85}
            axis.hist(values, weights=shares, color=SCORE_COLOURS[score], **look)
            if len(values):
                axis.axvline(np.median(values), color="black", linewidth=1, linestyle="--")
            median = f", median {np.median(values):.2f}" if len(values) else ""
            axis.set(xlim=(0, high), xlabel=axis_title(score), ylabel="share of matched objects")
            axis.set_title(f"{len(values):,} objects{median}")
        _draw_quadrants(cross, results)
        return style.save(figure, folder, "distributions")


def _draw_quadrants(axis: Any, results: RunResults) -> None:
    """The scatter; each quadrant is named outside of the cloud, with its share."""
    counted = quadrants(results)
    for key, title in QUADRANTS.items():
        rows = results.matched[results.matched.quadrant == key]
        label = f"{title}: {100 * counted[key]['share']:.0f} %"
        look = {"s": 9, "linewidths": 0, "alpha": 0.75, "clip_on": False, "rasterized": len(rows) > 2000}
        axis.scatter(rows.cdc, rows.r_lambda, color=QUADRANT_COLOURS[key], label=label, **look)
    axis.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.7)
    axis.axvline(CDC_LIMIT, color="black", linewidth=0.7)
    axis.set(xlim=(0, 2), ylim=(0, 1), xlabel=axis_title("cdc"), ylabel=axis_title("r_lambda"))
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=2, handletextpad=0.2, columnspacing=0.8, fontsize=7)


def draw_boxes(results: RunResults, folder: Any) -> Any:
    """Box plots of both scores for the four scans of the run's findings, and for each class (or shape)."""
    findings = results.run.record.findings
    scans = [scan.pair for scan in findings.scans.scans] if findings else []
    classes = results.matched.group.value_counts().index[:_MOST_CLASSES]
    parts = {
        kind: {name: rows for name in names if len(rows := results.matched[results.matched[column] == name])}
        for kind, column, names in (("scan", "pair_id", scans), (results.class_is, "group", classes))
    }
    width = [1 + len(groups) for groups in parts.values()]
    with style.new_figure(10, 3.3) as figure:
        axes = figure.subplots(1, 2, width_ratios=width, sharey=True)
        for axis, (kind, groups) in zip(axes, parts.items(), strict=True):
            drawn = _draw_groups(axis, groups)
            axis.set_xlabel(kind)
        axes[0].set_ylabel("score of an object (no unit)")
        figure.legend(handles=drawn, loc="outside upper center", ncols=2)
        return style.save(figure, folder, "box_plots")


def _draw_groups(axis: Any, groups: dict[str, pd.DataFrame]) -> list[Any]:
    """Two boxes per group; returns the legend entry of each score."""
    handles = []
    for offset, score in zip((-0.2, 0.2), SCORES, strict=True):
        values = {i + offset: rows[score].dropna().to_numpy() for i, rows in enumerate(groups.values())}
        known = {place: own for place, own in values.items() if len(own) >= FEWEST_IN_BOX} or {0.0: np.empty(0)}
        box = {"facecolor": SCORE_COLOURS[score], "linewidth": 0.6}
        flier, look = {"markerfacecolor": box["facecolor"]}, {"widths": 0.32, "manage_ticks": False}
        axis.boxplot([*known.values()], positions=[*known], patch_artist=True, boxprops=box, flierprops=flier, **look)
        handles.append(axis.bar(0, 0, edgecolor="black", label=METRIC[score].label, **box))
    names = [(style.shown_name(name, most=16), len(rows)) for name, rows in groups.items()]
    is_narrow = len(names) * max((len(name) for name, _ in names), default=0) > _MOST_LETTERS
    tilted = {"rotation": 25, "ha": "right", "rotation_mode": "anchor"} if is_narrow else {}
    ticks = [f"{name}{' ' if is_narrow else chr(10)}({n})" for name, n in names]
    axis.set_xticks(range(len(groups)), ticks, **tilted)
    axis.set(xlim=(-0.6, len(groups) - 0.4), ylim=(0, 2.02))
    axis.grid(axis="y")
    return handles


def _choose_objects(results: RunResults) -> list[int]:
    """Up to four objects to look at, as places in `matched`: of each class that of median r_lambda in the larger half.

    Labelled runs show car, vegetation, tree and wall, as the paper does, where they occur, then the most frequent other
    labels; others show the shape classes, then the largest objects.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    first = _CLASSES if results.class_is == "class" else tuple(SHAPES.values())
    frequent = scored.group.value_counts().index
    classes = sorted(frequent, key=lambda name: first.index(name) if name in first else len(first))
    chosen = []
    for name in classes[:4]:
        rows = scored[scored.group == name]
        large = rows[rows.n_keep >= rows.n_keep.median()].sort_values("r_lambda", kind="stable")
        chosen.append(int(large.index[len(large) // 2]))
    largest = scored.drop(chosen).sort_values("n_keep", ascending=False, kind="stable").index.tolist()
    return [*chosen, *largest][:4]
