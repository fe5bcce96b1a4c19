"""Redraws the pictures of docs/stages and docs/scores.md, and the numbers in the latter: python tools/pictures.py.

All is drawn from pairs of `fidpipe synth`, evaluated by `fidpipe run` under the default settings in .cache/pictures.
"""

import re
import sys
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from fidpipe.pipeline.report.figures import style
from fidpipe.pipeline.report.look import (
    FATE_WORDS,
    OUTCOME_COLOURS,
    OUTCOME_WORDS,
    QUADRANT_COLOURS,
    SIDE_COLOURS,
)
from fidpipe.pipeline.report.run_frames import coordinates, points_of, read_results
from fidpipe.pipeline.results.object_frame import CDC_LIMIT, R_LAMBDA_LIMIT
from fidpipe.schemas.cause_catalogue import CAUSES, UNEVEN
from fidpipe.schemas.columns import SIDES
from fidpipe.schemas.metric_catalogue import METRIC
from fidpipe.schemas.settings import Settings
from fidpipe.stages.coverage import COVERAGE_DISTANCES_M, nearest_distances
from fidpipe.stages.ground import WINDOW_M
from fidpipe.stages.pieces import CutScan, find_pieces
from fidpipe.stages.surface import describe_surface, measure_offsets
from object_pictures import (
    GOOD_ALIGNMENT_M,
    WORDS,
    MatchedObject,
    chosen_objects,
    draw,
    numbers_table,
    save,
    three_views,
)

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from runs import command

ROOT = Path(__file__).resolve().parents[1]
N_PAIRS = 16
GROUND_COLOUR = "#bbbbbb"
#: How many nodes the object of the pictures of one object has, more or less.
TYPICAL_NODES = 400
PANEL_SHAPE = 0.7  #: height over width
MOST_CAUSES = 8  #: in the picture of the causes
NEAR_M = 30.0  #: what is too fine for a whole scan is shown so far around the sensor


class PairView:
    """One pair as the pictures of the stages show it, with one of its matched objects."""

    def __init__(self, results, pair_id):
        self.results, self.run, self.pair_id = results, results.run, pair_id
        self.row = results.pairs.set_index("pair_id").loc[pair_id]
        matched = results.matched[results.matched.pair_id == pair_id]
        aligned = matched[
            matched.alignment_rms_m <= max(GOOD_ALIGNMENT_M, matched.alignment_rms_m.min())
        ]
        typical = (
            aligned.assign(off=(aligned.n_keep - TYPICAL_NODES).abs())
            .sort_values(["off", "real_id"])
            .iloc[0]
        )
        self.own = MatchedObject(results, typical)
        self.matched = matched
        clean = points_of(self.run, pair_id)
        self.rows = {side: points.query("not is_ground") for side, points in clean.items()}
        self.points = {side: coordinates(rows) for side, rows in self.rows.items()}
        self.frame = style.frame_of(*self.points.values())

    def centroids(self, side):
        """By object, the mean of its points from above, (n, 2)."""
        return self.rows[side].groupby("community_id")[["x", "y"]].mean().to_numpy()


def ground(axis, view):
    """The real scan from the side, what is cut away in grey."""
    clean = view.run.points(view.pair_id, "real")
    reach = np.hypot(clean.x, clean.y)
    for is_ground, colour, words in (
        (True, GROUND_COLOUR, "ground"),
        (False, SIDE_COLOURS["real"], "object points"),
    ):
        rows = clean.is_ground == is_ground
        places = np.column_stack([reach[rows], clean.height_m[rows]])
        style.dots(axis, places, 1.2, colour, label=f"{rows.sum():,} {words}")
    cut = view.row.ground_real_threshold_m - view.row.ground_real_peak_m
    axis.axhline(cut, color="black", linewidth=0.8)
    axis.set(
        xlim=(0, 40),
        ylim=(-1, 6),
        xlabel="distance from the sensor (m)",
        ylabel="height above the road (m)",
    )
    axis.set_title("what is cut away, seen from the side")


def draw_ground(view, path):
    """The scan from the side, and the heights from which road and cut are found."""
    with style.new_figure(8.4, 3.4) as figure:
        scan, heights = figure.subplots(1, 2, width_ratios=(1.7, 1))
        ground(scan, view)
        scan.legend(loc="upper left", markerscale=4, handletextpad=0.1)
        clean = view.run.points(view.pair_id, "real")
        near = clean[np.linalg.norm(clean[["x", "y", "z"]], axis=1) <= 30].height_m
        heights.hist(
            near, bins=np.arange(-1, 2, 0.02), orientation="horizontal", color=GROUND_COLOUR
        )
        cut = view.row.ground_real_threshold_m - view.row.ground_real_peak_m
        heights.axhspan(
            -WINDOW_M / 2, WINDOW_M / 2, color=SIDE_COLOURS["sim"], alpha=0.35, linewidth=0
        )
        heights.axhline(cut, color="black", linewidth=0.8)
        right = heights.get_xlim()[1]
        heights.text(right, cut, f"threshold, {cut:.2f} m", va="bottom", ha="right")
        heights.text(right, -0.09, "fullest window of 0.1 m: the road", va="top", ha="right")
        heights.set(
            ylim=(-0.5, 1.2),
            xlabel="points within 30 m, by 2 cm",
            ylabel="height above the road (m)",
        )
        heights.set_title(
            f"variance loss {view.row.ground_real_loss:.4f}, lowered {view.row.ground_real_iterations} times"
        )
        save(figure, path)


def sensor(axis, view):
    """Points of both sides by elevation: a peak for each beam."""
    for side in SIDES:
        points = view.run.points(view.pair_id, side)
        elevation = np.degrees(np.arctan2(points.z, np.hypot(points.x, points.y)))
        shares = np.full(len(points), 100 / len(points))
        style_of = {
            "color": SIDE_COLOURS[side],
            "histtype": "step",
            "linewidth": 0.7,
            "label": WORDS[side],
        }
        axis.hist(elevation, np.arange(-26, 16, 0.1), weights=shares, **style_of)
    axis.set(xlabel="elevation (degrees)", ylabel="points (%), by 0.1 degrees")
    axis.set_title("points by elevation")


def draw_sensor(view, path):
    """Points by elevation, and noise and losses of both sides."""
    with style.new_figure(8.4, 3.4) as figure:
        beams, noise, lost = figure.subplots(1, 3, width_ratios=(3, 1, 1))
        sensor(beams, view)
        beams.legend(loc="upper left")
        for axis, name, factor, unit in (
            (noise, "range_noise_m", 1e3, "mm"),
            (lost, "lost_share", 100, "%"),
        ):
            values = [factor * view.row[f"sensor_{side}_{name}"] for side in SIDES]
            axis.bar(
                [WORDS[side] for side in SIDES],
                values,
                color=[SIDE_COLOURS[side] for side in SIDES],
            )
            axis.set_title(f"{name.rsplit('_', 1)[0].replace('_', ' ')} ({unit})")
        save(figure, path)


def graph(axis, view):
    """The edges of one real object, and those of one of its nodes in front."""
    own = view.own.graphs["real"]
    places = view.own.seen(own.points)
    half = own.adjacency.tocoo()
    ends = np.column_stack([half.row, half.col])[half.row < half.col]
    shown = ends[:: len(ends) // 6000 + 1]
    look = {
        "colors": SIDE_COLOURS["real"],
        "linewidths": 0.3,
        "alpha": 0.15,
        "rasterized": True,
    }
    axis.add_collection(LineCollection(places[shown], **look))
    node = int(np.argsort(places[:, 0])[len(places) // 2])
    around = own.adjacency[[node]].indices
    rays = np.stack([np.broadcast_to(places[node], (len(around), 2)), places[around]], axis=1)
    axis.add_collection(LineCollection(rays, colors=SIDE_COLOURS["sim"], linewidths=0.5))
    style.dots(axis, places, 3, "black")
    axis.set(aspect="equal", xlabel="across (m)", ylabel="up (m)")
    axis.set_title(
        f"one object: {len(places)} nodes, {len(ends):,} edges; {len(around)} of one node"
    )


def draw_graph(view, path):
    """The graph of one object, and how far the 90 nearest neighbours reach near to the sensor and far from it."""
    edges = view.run.edges(view.pair_id, "real")
    points = view.points["real"]
    ids = view.rows["real"].point_id.to_numpy()
    ends = np.searchsorted(ids, edges[["src", "dst"]].to_numpy())
    longest = np.zeros(len(points))
    for end in ends.T:
        np.maximum.at(longest, end, edges.length_m.to_numpy())
    with style.new_figure(8.4, 3.4) as figure:
        own, reach = figure.subplots(1, 2, width_ratios=(1.7, 1))
        graph(own, view)
        style.dots(
            reach,
            np.column_stack([np.linalg.norm(points, axis=1), longest]),
            1.5,
            SIDE_COLOURS["real"],
        )
        reach.axhline(Settings().graph.tau_m, color="black", linewidth=0.8)
        reach.text(reach.get_xlim()[1], Settings().graph.tau_m, "tau", va="bottom", ha="right")
        reach.set(
            yscale="log",
            xlabel="distance from the sensor (m)",
            ylabel="longest edge of a node (m)",
        )
        ticks = (0.1, 0.3, 1, 3, 10, 30)
        reach.set_yticks(ticks, map(str, ticks))
        reach.set_title("how far edges reach")
        save(figure, path)


def colours_of(labels):
    """(n, 4) a colour for each label; neighbours in number differ."""
    return colormaps["Paired"](labels % 12)


def communities(axis, view, side="real"):
    """The objects of a side from above, each in a colour."""
    community = view.rows[side].community_id.to_numpy(int)
    style.dots(axis, view.points[side], 1.2, colours_of(community))
    axis.set_title(f"{len(np.unique(community))} {WORDS[side]} objects")
    style.from_above(axis, view.frame)


def draw_communities(view, path):
    """The objects of both sides."""
    with style.new_figure(8.4, 3.6) as figure:
        for axis, side in zip(
            figure.subplots(1, 2, sharex=True, sharey=True), SIDES, strict=True
        ):
            communities(axis, view, side)
        save(figure, path)


def matching(axis, view):
    """Centroids from above: matched ones joined, the others by what they are."""
    for points in view.points.values():
        style.dots(axis, points, 0.6, "#dddddd")
    centroids = {side: view.centroids(side) for side in SIDES}
    matched = view.matched
    pairs = np.stack([centroids[side][matched[f"{side}_id"]] for side in SIDES], axis=1)
    axis.add_collection(LineCollection(pairs, colors="black", linewidths=1))
    for column, side in enumerate(SIDES):
        axis.scatter(
            *pairs[:, column].T,
            s=14,
            c=SIDE_COLOURS[side],
            zorder=3,
            label=f"matched, {WORDS[side]}",
        )
    for status, side in (("not_found", "real"), ("extra", "sim")):
        unmatched = view.results.unmatched
        is_alone = (unmatched.pair_id == view.pair_id) & (unmatched.status == status)
        alone = unmatched[is_alone].community_id
        look = {"marker": "X", "s": 34, "edgecolors": "white", "linewidths": 0.5, "zorder": 3}
        axis.scatter(
            *centroids[side][alone].T,
            c=SIDE_COLOURS[side],
            label=f"{len(alone)} {FATE_WORDS[status]}",
            **look,
        )
        for place in centroids[side][alone] if status == "not_found" else ():
            axis.add_patch(
                Circle(
                    place,
                    Settings().matching.delta_m,
                    fill=False,
                    linewidth=0.4,
                    color="#777777",
                )
            )
    axis.set_title(f"{len(matched)} matched: match rate {view.row.match_rate:.2f}")
    axis.set(
        xlim=view.frame[:, 0],
        ylim=view.frame[:, 1],
        aspect="equal",
        xlabel="x, forward (m)",
        ylabel="y, left (m)",
    )


def draw_matching(view, path):
    """The centroids of a pair, and how far matched ones are apart in all pairs."""
    with style.new_figure(8.4, 4.2) as figure:
        above, apart = figure.subplots(1, 2, width_ratios=(1.9, 1))
        matching(above, view)
        above.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.25), ncols=4, handletextpad=0.1
        )
        distances = view.run.metrics.centroid_distance_m
        apart.hist(distances, bins=np.arange(0, 5.26, 0.25), color=GROUND_COLOUR)
        apart.axvline(Settings().matching.delta_m, color="black", linewidth=0.8)
        apart.text(
            Settings().matching.delta_m, apart.get_ylim()[1], "delta ", va="top", ha="right"
        )
        apart.set(xlabel="distance of matched centroids (m)", ylabel="objects")
        apart.set_title(f"{len(distances)} matched objects of {len(view.run.scored)} pairs")
        save(figure, path)


def coverage(axis, view, side="real"):
    """The points of a side from above by their distance to the other side, far ones on top."""
    distance_m = dict(zip(SIDES, nearest_distances(*view.points.values()), strict=True))[side]
    order = np.argsort(distance_m, kind="stable")
    ramp = {"cmap": style.FIDELITY_COLOURS, "vmin": 0, "vmax": COVERAGE_DISTANCES_M[-1]}
    coloured = style.dots(axis, view.points[side][order], 1.2, distance_m[order], **ramp)
    shares = " / ".join(
        f"{100 * np.mean(distance_m <= reach_m):.0f}" for reach_m in COVERAGE_DISTANCES_M
    )
    axis.set_title(f"{WORDS[side]}: {shares} % covered\nwithin 0.1 / 0.3 / 1 m")
    style.from_above(axis, view.frame)
    return coloured


def draw_coverage(view, path):
    """Both sides by distance."""
    with style.new_figure(8.4, 3.7) as figure:
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, side in zip(axes, SIDES, strict=True):
            coloured = coverage(axis, view, side)
        figure.colorbar(
            coloured, ax=axes, label="distance to the other side (m)", extend="max", shrink=0.8
        )
        save(figure, path)


def surface(axis, view):
    """The sampled real points whose neighbours form a plane, with their normals from above."""
    real = describe_surface(view.points["real"])
    style.dots(axis, view.points["real"], 0.6, "#dddddd")
    places = real.points[: len(real.normal)][real.is_plane][:, :2]
    normal = real.normal[real.is_plane][:, :2]
    axis.add_collection(LineCollection(np.stack([places, places + 1.5 * normal], axis=1), linewidths=0.4,
                                       colors=SIDE_COLOURS["real"]))  # fmt: skip
    offset = measure_offsets(real, describe_surface(view.points["sim"]))
    axis.set_title(
        f"normals of {len(places):,} planes; displaced by {offset.distance_m[0]:.3f} m"
    )
    style.from_above(axis, np.clip(view.frame, -NEAR_M, NEAR_M))


def draw_surface(view, path):
    """The planes of the real side, and the roughness of both."""
    with style.new_figure(8.4, 3.7) as figure:
        planes, rough = figure.subplots(1, 2, width_ratios=(1.5, 1))
        surface(planes, view)
        for side in SIDES:
            roughness = np.sort(describe_surface(view.points[side]).roughness_m)
            shares = np.arange(1, len(roughness) + 1) / len(roughness)
            rough.plot(
                roughness, shares, color=SIDE_COLOURS[side], linewidth=1.4, label=WORDS[side]
            )
            rough.axvline(
                view.row[f"roughness_{side}_m"],
                color=SIDE_COLOURS[side],
                linewidth=0.8,
                linestyle="--",
            )
        rough.set(
            xlim=(0, 0.5),
            ylim=(0, 1.02),
            xlabel="roughness (m); dashed: median",
            ylabel="share of the points",
        )
        rough.set_title(
            f"bias {view.row.roughness_bias_m:+.3f} m, area {view.row.roughness_area_m:.3f} m"
        )
        rough.legend(loc="lower right")
        save(figure, path)


def pieces(axis, view, side="real"):
    """The object points of a side from above in grey, its pieces each in a colour."""
    points = {own: view.run.points(view.pair_id, own) for own in SIDES}
    scans = [
        CutScan(
            own[["x", "y", "z"]].to_numpy(), own.is_ground.to_numpy(), own.height_m.to_numpy()
        )
        for own in points.values()
    ]
    found = find_pieces(*scans, Settings().pieces)[SIDES.index(side)]
    inside = found.labels >= 0
    style.dots(axis, view.points[side], 0.6, "#dddddd")
    places = points[side][["x", "y", "z"]].to_numpy()[inside]
    style.dots(axis, places, 1.5, colours_of(found.labels[inside]))
    word = "missing" if side == "real" else "invented"
    axis.set_title(
        f"{len(found.partner)} {word} pieces, {100 * found.share:.1f} % of the {WORDS[side]} points"
    )
    style.from_above(axis, view.frame)


def draw_pieces(view, path):
    """The missing and the invented pieces."""
    with style.new_figure(8.4, 3.6) as figure:
        for axis, side in zip(
            figure.subplots(1, 2, sharex=True, sharey=True), SIDES, strict=True
        ):
            pieces(axis, view, side)
        save(figure, path)


def rays(axis, view):
    """The rays by column and beam, coloured by their outcomes."""
    found = view.run.store.read_table("rays", view.pair_id).to_pandas()
    for outcome, colour in OUTCOME_COLOURS.items():
        own = found[found.outcome == outcome]
        axis.plot(
            own.column,
            own.beam,
            ".",
            color=colour,
            markersize=1.2,
            label=OUTCOME_WORDS[outcome],
        )
    axis.set_title("outcome of each ray")
    axis.set_xlabel("column")
    axis.set_ylabel("beam")


def draw_rays(view, path):
    """The rays, and the shares of their outcomes by range."""
    with style.new_figure(8.4, 3.6) as figure:
        left, right = figure.subplots(1, 2)
        rays(left, view)
        scores = (
            view.run.store.read_table("ray_scores", view.pair_id)
            .to_pandas()
            .query("by == 'range'")
        )
        scores = scores.sort_values(
            "band",
            key=lambda band: (
                band.str.extract(r"(\d+)")[0].astype(int) + band.str.startswith("over")
            ),
        )
        bottom = np.zeros(len(scores))
        for outcome, colour in OUTCOME_COLOURS.items():
            share = 100 * scores[f"rays_{outcome}"].to_numpy()
            right.bar(
                scores.band, share, bottom=bottom, color=colour, label=OUTCOME_WORDS[outcome]
            )
            bottom += share
        right.set_title("outcomes by range")
        right.set_ylabel("% of the rays")
        right.tick_params(axis="x", labelrotation=30)
        figure.legend(
            *right.get_legend_handles_labels(),
            loc="outside lower center",
            ncols=3,
            frameon=False,
        )
        save(figure, path)


def causes(axis, view):
    """Amounts of the causes of a pair in units of their tolerances, the largest ones."""
    table = (
        view.run.store.read_table("causes", view.pair_id).to_pandas().dropna(subset="amount")
    )
    table = table[table.cause != UNEVEN]
    table["size"] = table.amount / table.cause.map(lambda name: CAUSES[name].tolerance)
    table = table.loc[
        table["size"].abs().sort_values(ascending=False).index[:MOST_CAUSES][::-1]
    ]
    is_beyond = table["size"].abs() > 1
    axis.barh(
        table.cause,
        table["size"],
        color=np.where(is_beyond, SIDE_COLOURS["sim"], GROUND_COLOUR),
    )
    for limit in (-1, 1):
        axis.axvline(limit, color="black", linewidth=0.6)
    axis.set_xscale("symlog")
    axis.set_xticks((-10, -1, 0, 1, 10, 100), ("-10", "-1", "0", "1", "10", "100"))
    axis.tick_params(axis="y", labelsize=6)
    axis.set_title("amounts over tolerances")


def draw_causes(view, path):
    """The causes of a pair."""
    with style.new_figure(6.4, 3.6) as figure:
        axis = figure.subplots()
        causes(axis, view)
        axis.set_xlabel("amount / tolerance")
        save(figure, path)


def selection(axis, view, side="real"):
    """One object by the influence of its kept nodes; the others as rings."""
    own = view.own.graphs[side]
    nodes = view.own.nodes[side]
    table = view.run.table("selection", [view.pair_id]).to_pandas()
    table = table[table.real_id == view.own.row.real_id]
    both = table[["real_influence", "sim_influence"]].to_numpy()
    places = view.own.seen(own.points)
    dropped = np.setdiff1d(np.arange(len(places)), nodes)
    axis.scatter(
        *places[dropped].T, s=9, facecolors="none", edgecolors="#777777", linewidths=0.5
    )
    look = {"cmap": "viridis", "vmin": both.min(), "vmax": both.max()}
    coloured = style.dots(axis, places[nodes], 7, table[f"{side}_influence"], **look)
    axis.set_aspect("equal")
    return coloured


def draw_selection(view, path):
    """One object on both sides by influence, and its alignment."""
    with style.new_figure(8.4, 3.4) as figure:
        whole = [view.own.seen(view.own.graphs[side].points) for side in SIDES]
        kept = [
            view.own.kept(side) + view.own.kept("real", centred=False).mean(axis=0)
            for side in SIDES
        ]
        axes, between = three_views(figure, np.concatenate(whole + kept))
        for axis, side in zip(axes, SIDES, strict=False):
            coloured = selection(axis, view, side)
            axis.set_title(
                between.join(
                    [
                        f"{WORDS[side]}: {len(view.own.nodes[side])} of",
                        f"{len(view.own.graphs[side].points)} nodes kept",
                    ]
                )
            )
        figure.colorbar(coloured, ax=axes, label="influence", shrink=0.7, pad=0.02)
        axes[2].add_collection(
            LineCollection(np.stack(kept, axis=1), colors="black", linewidths=0.3)
        )
        for side, places in zip(SIDES, kept, strict=True):
            style.dots(axes[2], places, 4, SIDE_COLOURS[side])
        axes[2].set_title(
            between.join(
                ["aligned about their means:", f"{view.own.row.alignment_rms_m:.2f} m apart"]
            )
        )
        save(figure, path)


def metrics(axis, view, score="r_lambda"):
    """The real objects from above by a score; those without a partner in grey."""
    values = view.matched.set_index("real_id")[score]
    of_point = view.rows["real"].community_id.map(values).to_numpy(float)
    is_known = ~np.isnan(of_point)
    points = view.points["real"]
    style.dots(axis, points[~is_known], 1.5, "#cccccc")
    look = {"cmap": style.FIDELITY_COLOURS, "vmin": 0, "vmax": 1}
    coloured = style.dots(axis, points[is_known], 1.5, of_point[is_known], **look)
    axis.set_title(
        f"{METRIC[score].heading} of the real objects, mean {view.row[f'{score}_mean']:.2f}"
    )
    style.from_above(axis, view.frame)
    return coloured


def draw_metrics(view, path):
    """The objects of a pair by r_lambda and by CDC, and both scores of all objects of the run."""
    with style.new_figure(9.6, 3.3) as figure:
        *maps, both = figure.subplots(1, 3, width_ratios=(1, 1, 0.85))
        for axis, score in zip(maps, ("r_lambda", "cdc"), strict=True):
            coloured = metrics(axis, view, score)
        figure.colorbar(coloured, ax=maps, label="score", extend="max", shrink=0.8)
        matched = view.results.matched
        for name, rows in matched.groupby("quadrant"):
            style.dots(
                both,
                rows[["cdc", "r_lambda"]].to_numpy(dtype=float),
                9,
                QUADRANT_COLOURS[name],
                clip_on=False,
            )
        both.axvline(CDC_LIMIT, color="black", linewidth=0.6)
        both.axhline(R_LAMBDA_LIMIT, color="black", linewidth=0.6)
        both.set(xlim=(0, 2), ylim=(0, 1), xlabel="CDC: geometry", ylabel="r_lambda: structure")
        both.set_title(f"{len(matched)} objects of {len(view.run.scored)} pairs")
        save(figure, path)


#: How the result of each stage is drawn, by its name.
STAGE_PANELS = {
    "ground": ground,
    "sensor": sensor,
    "graph": graph,
    "communities": communities,
    "matching": matching,
    "coverage": coverage,
    "surface": surface,
    "pieces": pieces,
    "rays": rays,
    "causes": causes,
    "selection": selection,
    "metrics": metrics,
}
STAGE_PICTURES = {
    "ground": draw_ground,
    "sensor": draw_sensor,
    "graph": draw_graph,
    "communities": draw_communities,
    "matching": draw_matching,
    "coverage": draw_coverage,
    "surface": draw_surface,
    "pieces": draw_pieces,
    "rays": draw_rays,
    "causes": draw_causes,
    "selection": draw_selection,
    "metrics": draw_metrics,
}


def fill_panel(axis):
    """Widens what is shown to the shape of a panel, true to scale, so that all panels have the same size."""
    low, high = np.array([axis.get_xlim(), axis.get_ylim()]).T
    width = max(high[0] - low[0], (high[1] - low[1]) / PANEL_SHAPE)
    half = np.array([width, width * PANEL_SHAPE]) / 2
    middle = (low + high) / 2
    for set_limits, low_end, high_end in zip(
        (axis.set_xlim, axis.set_ylim), middle - half, middle + half, strict=True
    ):
        set_limits(low_end, high_end)


def draw_pipeline(view, path):
    """One panel per stage for the same pair, in order."""
    with style.new_figure(9.6, 3.4) as figure:
        axes = figure.subplots(2, -(-len(STAGE_PANELS) // 2)).ravel()
        for spare in axes[len(STAGE_PANELS) :]:
            spare.set_axis_off()
        for number, (axis, (name, panel)) in enumerate(
            zip(axes, STAGE_PANELS.items(), strict=False), 1
        ):
            panel(axis, view)
            axis.set(title=f"{number} {name}", xlabel="", ylabel="")
            if name in ("ground", "sensor", "rays", "causes"):
                axis.set_box_aspect(PANEL_SHAPE)
            else:
                fill_panel(axis)
            axis.tick_params(labelsize=6)
        save(figure, path)


def draw_all(run, folder):
    """Writes all pictures of a run; returns the chosen row of each example object."""
    results = read_results(run)
    view = PairView(results, sorted(results.pairs.pair_id)[0])
    draw_pipeline(view, folder / "pipeline.png")
    for name, draw_stage in STAGE_PICTURES.items():
        draw_stage(view, folder / f"{name}.png")
    chosen = chosen_objects(results)
    for example, row in chosen.items():
        draw(example, row, results, folder)
    return chosen


def with_numbers(text, chosen):
    """The text of docs/scores.md with the table of the chosen objects between its two marks, which must be there."""
    marks = re.compile(r"(<!-- objects: .*? -->\n).*?(<!-- end of objects -->)", re.DOTALL)
    text, n = marks.subn(lambda found: found[1] + numbers_table(chosen) + found[2], text)
    if n != 1:
        raise ValueError(f"docs/scores.md: expected one table marked 'objects', got {n}")
    return text


def main(folder):
    """Makes the dataset and the run, draws the pictures, and writes the numbers."""
    for words in (
        ("synth", folder / "streets", "--pairs", N_PAIRS),
        ("run", folder / "streets", "--out", folder / "run"),
    ):
        done = command(*words, timeout=1800)
        if done.returncode:
            raise SystemExit(done.stderr)
    pictures = ROOT / "docs" / "pictures"
    page = ROOT / "docs" / "scores.md"
    pictures.mkdir(exist_ok=True)
    chosen = draw_all(folder / "run", pictures)
    page.write_text(with_numbers(page.read_text(encoding="utf-8"), chosen), encoding="utf-8")


if __name__ == "__main__":
    main(ROOT / ".cache" / "pictures")
