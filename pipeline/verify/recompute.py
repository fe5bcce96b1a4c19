"""Recomputation of the tables of a pair as data frames: each from the stored tables before it, by `stages.literal`.

If ties or rounding allow several correct answers, the stored one is accepted if it is one of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.distance import cdist

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import BASELINES, COVERAGE_REACHES, METRIC, OBJECT_METRICS, SHIFT_COLUMNS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IndexArray
from ...stages.clean import as_ros
from ...stages.inspect.sensor_description import PAIR_COLUMNS, describe_sensor, sensor_row
from ...stages.literal import literal_baselines as distances
from ...stages.literal import literal_method, literal_surfaces
from ...stages.literal import literal_pieces as surface_pieces
from ..jobs import EXTRAS, STAGES
from ..stage import Stage
from .compare_frames import DEFAULT_TOLERANCE, MERGE_GAIN
from .recompute_nvs import nvs
from .recompute_rays import rays
from .stored import Part, Skipped, StoredPair, StoredSide, values

Parts = Iterator[Part | Skipped]

#: Objects with more points are left out of checks that need dense matrices of all their nodes.
MOST_NODES = 3000
#: The relative and absolute difference that two ways of computing an influence may have.
_ROUNDING = 1e-11
_FEWEST_FOR_SPECTRA = 3
_FEWEST_FOR_PLANES = 20
_SAMPLE_POINTS = 2000
_NODES_PER_OBJECT = 3
_PLACE = ("cx", "cy", "cz", "range_m", "extent_x", "extent_y", "extent_z")
_DESCRIBED = (*_PLACE, "linearity", "planarity", "scattering")
_ROUGHNESS = ("roughness_real_m", "roughness_sim_m", "roughness_bias_m", "roughness_area_m")
_REACHES_M = dict(zip(COVERAGE_REACHES, (0.1, 0.3, 1.0), strict=True))
_FROM_SCANS = ("point_id", "x", "y", "z", "intensity", "label", "instance")
#: Baselines that need the graphs or the aligned nodes of an object.
_OF_OBJECTS = ("emd", "netlsd", "r_h")
UNMATCHED = {"real": "missing", "sim": "hallucinated"}


def stages_of(pair: StoredPair) -> list[Stage]:
    """Stages of a run with the settings of the pair, in their order."""
    return [stage for stage in (*STAGES, *EXTRAS) if stage.is_wanted is None or stage.is_wanted(pair.settings)]


def rows(pair: StoredPair) -> Parts:
    """Names of pair and side in the rows of every table, and their order by the keys, without duplicates."""
    for table, side in [(table, side) for stage in stages_of(pair) for side in stage.parts for table in stage.gives]:
        frame = pair.table(table, side)
        names = {"pair_id": pair.pair_id} | ({"side": side} if side else {})
        stored: Row = {f"{table}.{name}": int((frame[name] != own).sum()) for name, own in names.items()}
        keys = [frame[key].replace(-1, np.inf) for key in TABLES[table].keys]  # nulls last
        is_after = np.zeros(max(0, len(frame) - 1), dtype=bool)
        is_same = ~is_after
        for key in keys:
            before, after = key.to_numpy()[:-1], key.to_numpy()[1:]
            is_after |= is_same & (before < after)
            is_same &= before == after
        stored[f"rows of {table} not in order, or twice"] = int((~is_after).sum())
        yield values("rows", stored, dict.fromkeys(stored, 0), side)


def scan(pair: StoredPair) -> Parts:
    """Points that cleaning keeps, one by one."""
    settings = pair.settings.input
    for side in SIDES:
        read = pair.scan(side)
        if read is None:
            of_ground = [f"ground.{name}" for name in _FROM_SCANS]
            yield Skipped("", [*of_ground, "sensor", *(f"pairs.n_{side}_raw" for side in SIDES)])
            return
        transform = pair.scans.T_real_sim if pair.scans and side == "sim" else None
        T = np.array(transform).reshape(3, 4) if transform else None
        limits = settings.min_range_m, settings.max_range_m, settings.exclude_box, T
        frame_of_side, box = settings.frame_of(side), settings.include_box
        kept, points = literal_method.clean(read.points, *limits, frame=frame_of_side, include_box=box)
        frame = {"point_id": np.array(kept, dtype=np.intp), **dict(zip("xyz", points.T, strict=True))}
        for name, own in (("intensity", read.intensity), ("instance", read.instances), ("label", read.labels)):
            frame[name] = None if own is None else own[kept]
        yield pair.part("scan", frame, side)
        yield pair.in_pairs({f"n_{side}_raw": len(read.points)})


def ground(pair: StoredPair) -> Parts:
    """Heights and flags of all clean points, and the cut."""
    settings = pair.settings.ground
    for side in SIDES:
        stored, facts = pair.table("ground", side), pair.metadata("ground", side)
        cut, heights, is_clear = _cut(pair, side)
        frame = {"point_id": stored["point_id"].to_numpy(), "height_m": heights - cut["peak_m"]}
        if settings.method == "patchwork":
            yield Skipped("flags of ground by patchwork++: fidpipe has no second implementation", ["ground.is_ground"])
        else:
            threshold_m = -np.inf if cut["threshold_m"] is None else cut["threshold_m"]
            is_close = np.abs(heights - threshold_m) <= DEFAULT_TOLERANCE
            frame["is_ground"] = np.where(is_close, stored["is_ground"], heights < threshold_m)
        yield pair.part("ground", frame, side, is_whole=False)
        n_ground, axis = int(stored["is_ground"].sum()), cut.pop("axis")
        yield pair.in_pairs({f"n_{side}_clean": len(stored), f"n_{side}_points": len(stored) - n_ground})
        cut["removed_share"] = n_ground / len(stored)
        if not is_clear:
            yield Skipped("tilt of a scan with equal variance along two axes", [f"pairs.ground_{side}_tilt_deg"])
            del cut["tilt_deg"]
        yield pair.in_pairs({f"ground_{side}_{name}": value for name, value in cut.items()})
        cut |= {f"axis {name}": value for name, value in zip("xyz", axis.tolist(), strict=True)}
        noted = facts | {f"axis {name}": value for name, value in zip("xyz", facts["axis"], strict=True)}
        yield values("ground", {f"metadata {name}": noted[name] for name in cut},
                     {f"metadata {name}": value for name, value in cut.items()}, side)  # fmt: skip


def _cut(pair: StoredPair, side: str) -> tuple[dict[str, Any], FloatArray, bool]:
    """Cut of a side from its metadata, heights of its points, and True if the points determine the axis."""
    settings, points = pair.settings.ground, pair.sides[side].all_points
    limits = settings.prior_m, settings.max_variance_loss, settings.loss
    own = literal_method.ground(points, *limits, default_axis=np.array(pair.metadata("ground", side)["axis"]))
    heights = own.height_m
    cut = {name: getattr(own, name) for name in ("axis", "tilt_deg", "peak_m", "threshold_m", "loss", "iterations")}
    if side == "sim" and (settings.shared or settings.peak == "real"):
        real = pair.metadata("ground", "real")
        axis = np.array(real["axis"])
        offset_m = 0.0 if settings.shared else literal_method.road_offset(pair.sides["real"].all_points, points, axis)
        if offset_m is not None:
            cut = {name: real[name] for name in cut} | {"axis": axis, "peak_m": real["peak_m"] + offset_m}
            heights = np.array([float(p @ axis) for p in points])
            if real["threshold_m"] is not None:
                cut["threshold_m"] = real["threshold_m"] + offset_m
            threshold_m = cut["threshold_m"] or 0.0
            cut["loss"] = literal_method.variance_loss(points, heights, threshold_m, cut["peak_m"], settings.loss)
    if settings.method != "pca":
        cut |= dict.fromkeys(("threshold_m", "loss", "iterations"))
    return cut, heights, own.is_unique


def sensor(pair: StoredPair) -> Parts:
    """Description of both sensors, by the same code."""
    for side in SIDES:
        stored = pair.table("sensor", side)
        yield pair.in_pairs({f"sensor_{side}_{name.removeprefix('n_')}": stored[name][0] for name in PAIR_COLUMNS})
        read = pair.scan(side)
        if read is not None:
            points = as_ros(read.points, pair.settings.input.frame_of(side))
            row = sensor_row(describe_sensor(points, read.rings, read.times_s is not None))
            yield pair.part("sensor", [row | {"side": side}], side)


def graph(pair: StoredPair) -> Parts:
    """Length of every edge, and edges of some nodes."""
    for side, own in pair.sides.items():
        src, dst, stored_length = own.edges
        nodes = np.arange(len(own.points)) if pair.sample.all_nodes else _drawn_nodes(pair, side)
        is_looked_at = np.isin(src, nodes) | np.isin(dst, nodes)
        edges = sorted({edge for node in nodes.tolist() for edge in _edges_of(pair, own, node)})
        found = np.array(edges, dtype=np.intp).reshape(-1, 2)
        frames = (
            pd.DataFrame({"src": own.point_ids[i], "dst": own.point_ids[j]}).set_index(["src", "dst"])
            for i, j in ((src[is_looked_at], dst[is_looked_at]), (found[:, 0], found[:, 1]))
        )
        yield Part("graph", next(frames), next(frames), side)
        length = np.sqrt(((own.points[src] - own.points[dst]) ** 2).sum(axis=1)).astype(np.float32)
        for i in np.flatnonzero(length != stored_length).tolist():  # a fixed order of operations: the last bit matters
            length[i] = literal_method.distances(own.points[dst[i], None], own.points[src[i]])[0]
        stored = pair.table("graph", side).set_index(["src", "dst"])
        yield Part("graph", stored, pd.DataFrame({"length_m": length}, index=stored.index), side, is_whole=False)


def _drawn_nodes(pair: StoredPair, side: str) -> IndexArray:
    """Random nodes of the drawn objects of a side."""
    nodes: list[int] = []
    for community in pair.drawn_ids(side):
        members = pair.sides[side].members(community)
        nodes += pair.sample.rng.choice(members, min(_NODES_PER_OBJECT, len(members)), replace=False).tolist()
    return np.array(nodes, dtype=np.intp)


def _edges_of(pair: StoredPair, own: StoredSide, node: int) -> list[tuple[int, int]]:
    """Edges of a node: those that it requires, and those stored ones that the other end requires."""
    settings = pair.settings.graph
    distances = literal_method.distances(own.points, own.points[node])
    within = set(np.flatnonzero(distances <= settings.tau_m).tolist()) - {node}
    is_union = settings.edges == "union"
    needed = own.nearest(node) | within if is_union else own.nearest(node) & within
    of_others = {j for j in own.neighbours(node) - needed if node in own.nearest(j) and (is_union or j in within)}
    return [(min(node, j), max(node, j)) for j in needed | of_others]


def communities(pair: StoredPair) -> Parts:
    """Object of every object point: by Louvain's method, or that of the nearest real point."""
    settings = pair.settings.communities
    is_reference = settings.objects == "reference"
    for side, own in pair.sides.items():
        n = len(own.points)
        if is_reference and side == "sim":
            labels = _reference_labels(pair, own)
        else:
            order = np.array(literal_surfaces.visiting_order(own.points, settings.seed) if is_reference else range(n))
            labels = _canonical(own.labels, order)
            if is_reference and settings.reference != "louvain":
                yield Skipped(f"objects by {settings.reference} of the input")
            else:
                if own.edges[2].any():
                    gain = max(0.0, literal_method.best_merge_gain(own.labels, *own.edges))
                    yield values("communities", {MERGE_GAIN: gain}, {MERGE_GAIN: 0.0}, side)
                if settings.backend != "scikit-network" or not pair.has_same_library("scikit-network"):
                    yield Skipped("communities of a graph by another Louvain than that of the installed scikit-network")
                elif not own.edges[2].any():
                    yield Skipped("connected components of a graph without lengths")
                else:
                    visits = order if is_reference else np.random.RandomState(settings.seed).permutation(n)
                    labels = _canonical(np.array(literal_method.louvain(n, *own.edges, visits)), order)
        yield pair.part("communities", {"point_id": own.point_ids, "community_id": labels}, side)


def _reference_labels(pair: StoredPair, own: StoredSide) -> IndexArray:
    """Object of each simulated point: that of the nearest real point, or out of reach a separate one.

    For equal distances any of the points is accepted. Points of objects that are not drawn are copied, unless both
    sides are compared as a whole.
    """
    settings, real, stored = pair.settings.communities, pair.sides["real"], own.labels
    n_real, expected, sizes = int(real.labels.max()) + 1, own.labels.copy(), np.bincount(stored[stored >= 0])

    def number(points: IndexArray, groups: IndexArray) -> IndexArray:
        return _canonical(
            groups, np.array(literal_surfaces.visiting_order(own.points[points], settings.seed), dtype=np.intp)
        )

    hallucinated = np.flatnonzero(stored >= n_real)
    expected[hallucinated] = n_real + number(hallucinated, stored[hallucinated])
    checked = [i for community in pair.drawn_ids("sim") for i in own.members(community).tolist()]
    found = np.zeros(len(stored), dtype=bool)
    if pair.sample.whole_sides:
        outside = np.flatnonzero(literal_method.nearest_distances(own.points, real.points) > settings.reach_m)
        groups = np.array(surface_pieces.components(own.points[outside], pair.settings.pieces.link_m), dtype=np.intp)
        groups = number(outside, groups)
        is_object = np.bincount(groups)[groups] >= settings.min_points
        found[outside[is_object]] = True
        expected[found] = n_real + groups[is_object]
        checked = [i for i in {*checked, *hallucinated.tolist()} if not found[i]]
    for i in checked:
        apart = literal_method.distances(real.points, own.points[i])
        near = real.labels[apart <= apart.min() * (1 + 1e-12)]
        is_out_of_reach = (
            stored[i] >= n_real and sizes[stored[i]] >= settings.min_points and apart.min() > settings.reach_m
        )
        if stored[i] not in near and (pair.sample.whole_sides or not is_out_of_reach):
            expected[i] = near[0]
    return expected


def _canonical(labels: IndexArray, order: IndexArray) -> IndexArray:
    """Renumber a partition by size and then by the first of its points in an order; -1 is kept."""
    numbered = np.full(len(labels), -1, dtype=np.intp)
    in_object = order[labels[order] >= 0]
    numbered[in_object] = literal_method.canonical(labels[in_object].tolist())
    return numbered


def objects(pair: StoredPair) -> Parts:
    """Number of points of every object; place, size, shape and label of the drawn ones."""
    for side, own in pair.sides.items():
        yield pair.part("objects", {"community_id": range(len(own.sizes)), "n_points": own.sizes}, side)
        words = pair.table("ground", side)["label"].to_numpy()[own.is_object]
        drawn = []
        for community in pair.drawn_ids(side):
            members = own.members(community)
            expected: list[float | None] = [None] * len(_DESCRIBED)
            if len(members):
                about = literal_method.describe(own.points[members])
                expected = [*about.centroid, about.range_m, *about.extent, *about.shape]
            row: Row = {"community_id": community, "label": _most_frequent(words[members])}
            drawn.append(row | dict(zip(_DESCRIBED, expected, strict=True)))
        yield pair.part("objects", drawn, side, is_whole=False)


def _most_frequent(words: Iterable[Any]) -> str | None:
    """Most frequent word, for equal counts the first in the alphabet; None if all are null."""
    named = [word for word in words if not pd.isna(word)]
    return min(set(named), key=lambda word: (-named.count(word), word)) if named else None


def matching(pair: StoredPair) -> Parts:
    """Matches of all objects."""
    tables = {side: pair.table("objects", side) for side in SIDES}
    real, sim = (tables[side][["cx", "cy", "cz"]].to_numpy() for side in SIDES)
    settings = pair.settings.matching
    pairs = sorted((row["real_id"], row["sim_id"]) for row in pair.matched)
    unmatched_sim = set(range(len(sim)))
    if pair.settings.communities.objects == "reference":
        n_real, n_sim = (tables[side]["n_points"].to_numpy() for side in SIDES)
        least = pair.settings.communities.min_points
        pairs = [(i, i) for i in range(len(real)) if n_sim[i] >= min(least, n_real[i])]
        unmatched_sim = set(range(len(real), len(sim)))
    elif settings.method == "greedy":
        found = literal_method.match_greedy(real, sim, settings.delta_m, dict(pairs), DEFAULT_TOLERANCE)
        pairs = [(i, j) for i, j, _ in found]
    else:
        yield _optimum(real, sim, pairs, settings.delta_m)
    expected: list[Row] = [
        {"real_id": i, "sim_id": j, "status": "matched", "centroid_distance_m": math.dist(real[i], sim[j])}
        for i, j in pairs
    ]
    missing = sorted(set(range(len(real))) - {i for i, _ in pairs})
    expected += [{"real_id": i, "sim_id": -1, "status": "missing", "centroid_distance_m": None} for i in missing]
    unmatched = sorted(unmatched_sim - {j for _, j in pairs})
    expected += [{"real_id": -1, "sim_id": j, "status": "hallucinated", "centroid_distance_m": None} for j in unmatched]
    yield pair.part("matching", expected)


def _optimum(real: FloatArray, sim: FloatArray, pairs: list[tuple[int, int]], delta_m: float) -> Part:
    """Number and mean distance of the stored matches below delta, and those of an optimal matching."""
    n, least = max(len(real), len(sim)), min(len(real), len(sim))
    apart, forbidden = cdist(real, sim), delta_m * (least + 1)
    cost = np.zeros((n, n))
    cost[: len(real), : len(sim)] = np.where(apart < delta_m, apart, forbidden)
    total = math.fsum(apart[i, j] for i, j in pairs) + (least - len(pairs)) * forbidden
    what, within = "mean distance, m", "matches nearer than delta"
    stored = {what: total / n, within: sum(apart[i, j] < delta_m for i, j in pairs)}
    return values("matching", stored, {what: literal_method.least_total(cost) / n, within: len(pairs)})


def coverage(pair: StoredPair) -> Parts:
    """Coverage of each drawn object; for whole sides the mean over their objects."""
    sizes = [(side, i, n) for side, own in pair.sides.items() for i, n in enumerate(own.sizes.tolist())]
    sizes += [(side, -1, len(own.points)) for side, own in pair.sides.items()]
    columns = ("side", "community_id", "n_points")
    yield pair.part("coverage", dict(zip(columns, zip(*sizes, strict=True), strict=True)))
    for side, other in (SIDES, SIDES[::-1]):
        own, others, cut = pair.sides[side], pair.sides[other].points, pair.metadata("ground", other)
        drawn = {community: own.members(community) for community in pair.drawn_ids(side)}
        if pair.sample.whole_sides:
            drawn[-1] = np.arange(len(own.points))
        expected = [
            {"side": side, "community_id": community} | _covered(own.points[members], others, cut)
            for community, members in drawn.items()
        ]
        yield pair.part("coverage", expected, is_whole=False)
        stored = pair.table("coverage").query("side == @side")
        whole = stored[stored["community_id"] == -1].iloc[0]
        yield pair.in_pairs({f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in COVERAGE_REACHES})
        if (own.labels < 0).any():
            yield Skipped("coverage of a whole side as the mean of its objects, if some points belong to none")
            continue
        parts = stored[(stored["community_id"] >= 0) & (stored["n_points"] > 0)]
        shares = parts[[*(f"covered_{reach}" for reach in COVERAGE_REACHES), "road_share"]].astype(float)
        means = shares.mul(parts["n_points"], axis=0).sum(skipna=False) / parts["n_points"].sum()
        mean = {"side": side, "community_id": -1} | means.to_dict()
        yield pair.part("coverage", [mean], is_whole=False)


def _covered(points: FloatArray, others: FloatArray, cut: dict[str, Any]) -> Row:
    """Covered shares of points, their median distance from the other side, and the share below its cut."""
    if not len(points):
        return dict.fromkeys((*(f"covered_{reach}" for reach in _REACHES_M), "median_distance_m", "road_share"))
    apart = literal_method.nearest_distances(points, others).tolist()
    row: Row = {f"covered_{reach}": literal_surfaces.covered(apart, reach_m) for reach, reach_m in _REACHES_M.items()}
    row |= {"median_distance_m": float(np.median(apart)), "road_share": None}
    if cut["threshold_m"] is not None:
        heights = [float(p @ np.array(cut["axis"])) for p in points]
        row["road_share"] = sum(h < cut["threshold_m"] for h in heights) / len(heights)
    return row


def surface(pair: StoredPair) -> Parts:
    """Displacement of the surfaces of the drawn real objects; for whole sides also the roughness."""
    stored = pair.table("surface").set_index("real_id")
    ids = [*range(len(pair.table("objects", "real"))), -1]
    yield pair.part("surface", {"real_id": ids})
    yield pair.in_pairs({column: stored.loc[-1, column] for column in SHIFT_COLUMNS})
    points, sim = pair.sides["real"].points, pair.sides["sim"].points
    planes = {i: literal_surfaces.local_plane(points, points[i]) for i in _plane_points(pair, "real")}
    labels = pair.sides["real"].labels
    drawn = {community: [planes[i] for i in planes if labels[i] == community] for community in pair.drawn_ids("real")}
    if pair.sample.whole_sides:
        drawn[-1] = list(planes.values())
    expected = []
    for community, own in drawn.items():
        if any(plane.is_tied for plane in own):
            yield Skipped("displacement of an object with ties among the neighbours of its points", ["surface"])
            continue
        offset = literal_surfaces.offset(own, sim)
        row = {"real_id": community, "n_points": offset.n_points, "n_directions": offset.n_directions}
        expected.append(row | dict(zip(SHIFT_COLUMNS, (*offset.shift_m, offset.distance_m), strict=True)))
    yield pair.part("surface", expected, is_whole=False)
    if not pair.sample.whole_sides:
        return
    of_sim = [literal_surfaces.local_plane(sim, sim[i]) for i in _plane_points(pair, "sim")]
    if any(plane.is_tied for plane in (*planes.values(), *of_sim)):
        yield Skipped("roughness of a pair with ties among the neighbours of its points",
                      [f"pairs.{name}" for name in _ROUGHNESS])  # fmt: skip
        return
    roughness: dict[str, float | None] = dict.fromkeys(_ROUGHNESS)
    if planes and of_sim:
        a, b = (np.array([plane.roughness_m for plane in own]) for own in (planes.values(), of_sim))
        bias = float(b.mean() - a.mean())
        area = literal_surfaces.area_between(a.tolist(), (b - bias).tolist())
        roughness = dict(zip(_ROUGHNESS, (float(np.median(a)), float(np.median(b)), bias, area), strict=True))
    yield pair.in_pairs(roughness)


def _plane_points(pair: StoredPair, side: str) -> list[int]:
    """Sampled points for planes; only those of drawn objects, unless whole sides are compared."""
    own = pair.sides[side]
    if len(own.points) < _FEWEST_FOR_PLANES:
        return []
    sample = literal_surfaces.visiting_order(own.points)[:_SAMPLE_POINTS]
    drawn = set(pair.drawn_ids(side))
    return [i for i in sample if pair.sample.whole_sides or own.labels[i] in drawn]


def pieces(pair: StoredPair) -> Parts:
    """Numbers, shares and moves of the stored pieces; for whole sides the pieces themselves."""
    stored = pair.table("pieces")
    if pair.sample.whole_sides:
        yield pair.part("pieces", _pieces(pair, "real", "sim") + _pieces(pair, "sim", "real"))
    else:
        yield Skipped("", ["pieces"])
    of_side = {side: stored[stored["side"] == side].to_dict("records") for side in SIDES}
    for side, word in (("real", "missing"), ("sim", "invented")):
        share = sum(row["n_points"] for row in of_side[side]) / len(pair.sides[side].points)
        yield pair.in_pairs({f"n_{word}_pieces": len(of_side[side]), f"{word}_pieces_share": share})
    places = {
        side: [([row[f"c{a}"] for a in "xyz"], [row[f"extent_{a}"] for a in "xyz"]) for row in rows]
        for side, rows in of_side.items()
    }
    to_sim = surface_pieces.moved(places["real"], places["sim"])
    to_real = {j: i for i, j in to_sim.items()}
    expected: list[Row] = []
    for side, partners in (("real", to_sim), ("sim", to_real)):
        for i in range(len(of_side[side])):
            row: Row = {"side": side, "piece_id": i, "fate": "gone", "partner_id": None}
            row |= {f"moved_{axis}_m": None for axis in "xyz"}
            if i in partners:
                row |= {"fate": "moved", "partner_id": partners[i]}
                real, sim = (i, partners[i]) if side == "real" else (partners[i], i)
                vector = np.subtract(places["sim"][sim][0], places["real"][real][0]).tolist()
                row |= {f"moved_{axis}_m": value for axis, value in zip("xyz", vector, strict=True)}
            expected.append(row)
    yield pair.part("pieces", expected, is_whole=False)


def _pieces(pair: StoredPair, side: str, other: str) -> list[Row]:
    """Recomputed pieces of a side."""
    own, settings, table = pair.sides[side], pair.settings.pieces, pair.table("ground", side)
    limits = settings.reach_m, settings.link_m, settings.min_points
    others, heights = pair.sides[other].all_points, table["height_m"].to_numpy()
    expected = []
    for i, piece in enumerate(surface_pieces.pieces(own.all_points, ~own.is_object, heights, others, *limits)):
        place = (*piece.about.centroid, piece.about.range_m, *piece.about.extent)
        row = {"side": side, "piece_id": i, "n_points": piece.about.n_points, "bearing_deg": piece.bearing_deg}
        row |= {"height_m": piece.height_m, "label": _most_frequent(table["label"].to_numpy()[piece.members])}
        expected.append(row | dict(zip(_PLACE, place, strict=True)))
    return expected


def selection(pair: StoredPair) -> Parts:
    """Number of aligned nodes of every object; for the drawn ones the nodes, their influence and alignment."""
    ids = ("real_id", "sim_id")
    ranks = [{name: row[name] for name in ids} | {"rank": k} for row in pair.matched for k in range(pair.n_kept(row))]
    yield pair.part("selection", ranks)
    expected: list[Row] = []
    for match in pair.drawn_matches:
        members = pair.members(match)
        if max(len(nodes) for nodes in members.values()) > MOST_NODES:
            columns = [f"selection.{side}_{what}" for side in SIDES for what in ("point_id", "influence")]
            yield Skipped(
                f"influence and scores of an object of more than {MOST_NODES} points (dense matrices)", columns
            )
            continue
        by_column: dict[str, Any] = {}
        for side in SIDES:
            nodes, influence = _selected(pair, match, side, members[side])
            by_column |= {f"{side}_point_id": pair.sides[side].point_ids[nodes], f"{side}_influence": influence}
        by_rank = zip(*by_column.values(), strict=True)
        own = {name: match[name] for name in ids}
        expected += [own | {"rank": k} | dict(zip(by_column, row, strict=True)) for k, row in enumerate(by_rank)]
        kept, what = pair.kept(match), "mean distance of aligned nodes, m"
        a, b = (pair.sides[side].points[kept[side]] for side in SIDES)
        cost = cdist(a - a.mean(axis=0), b - b.mean(axis=0))
        stored = {what: math.fsum(np.diag(cost)) / len(cost)}
        yield values("selection", stored, {what: literal_method.least_total(cost) / len(cost)}, **own)
    yield pair.part("selection", expected, is_whole=False)


def _selected(pair: StoredPair, match: Row, side: str, members: IndexArray) -> tuple[IndexArray, list[float]]:
    """Kept nodes of a side of an object, by rank, and their influence.

    The stored nodes are accepted if no other node has more influence, up to rounding; the real ones in the order of
    their influence.
    """
    own, rows, n_keep = pair.sides[side], pair.selected(match), pair.n_kept(match)
    expected = literal_method.influence(literal_method.laplacian(own.matrix(members)), pair.settings.selection.t)
    of_node = dict(zip(members.tolist(), expected.tolist(), strict=True))
    chosen, stored = own.index(rows[f"{side}_point_id"]).tolist(), rows[f"{side}_influence"].tolist()
    precedence = sorted((-value, node) for value, node in zip(stored, chosen, strict=True))
    left_out = of_node.keys() - set(chosen)
    is_right = len(set(chosen)) == len(chosen) == n_keep and of_node.keys() >= set(chosen)
    if is_right and all((-round(of_node[i] * (1 - _ROUNDING) - _ROUNDING, 9), i) > precedence[-1] for i in left_out):
        nodes = [node for _, node in precedence] if side == "real" else chosen
    else:
        nodes = sorted(of_node, key=lambda i: (-round(of_node[i], 9), i))[:n_keep]
    return np.array(nodes, dtype=np.intp), [of_node[i] for i in nodes]


def metrics(pair: StoredPair) -> Parts:
    """Scores of the drawn objects, from the nodes that the selection kept."""
    keys, sizes = ["real_id", "sim_id"], {side: pair.table("objects", side)["n_points"] for side in SIDES}
    known = [
        {name: match[name] for name in (*keys, "centroid_distance_m")}
        | {f"n_{side}": sizes[side][match[f"{side}_id"]] for side in SIDES}
        | {"n_keep": pair.n_kept(match)}
        for match in pair.matched
    ]
    yield pair.part("metrics", known)
    for match in pair.drawn_matches:
        members, kept = pair.members(match), pair.kept(match)
        row: Row = {name: match[name] for name in keys}
        row["cdc"] = literal_method.cdc(*(pair.sides[side].points[members[side]] for side in SIDES))
        row["alignment_rms_m"] = literal_method.alignment_rms(*(pair.sides[side].points[kept[side]] for side in SIDES))
        n_keep = len(kept["real"])
        if n_keep > MOST_NODES:
            what = f"spectra of an object of more than {MOST_NODES} aligned nodes (dense matrices)"
            yield Skipped(what, [f"metrics.{name}" for name in (*literal_method.SPECTRAL, "status", "reason")])
        elif n_keep < _FEWEST_FOR_SPECTRA:
            reason = f"{n_keep} aligned nodes, at least 3 are needed for a spectrum"
            row |= dict.fromkeys(literal_method.SPECTRAL) | {"status": "too_small", "reason": reason}
        else:
            L_real, L_sim = (literal_method.laplacian(pair.sides[side].matrix(kept[side])) for side in SIDES)
            row |= literal_method.spectral(L_real, L_sim)
            is_identical = row["laplacian_change"] <= literal_method.IDENTICAL_CHANGE
            row |= {"status": "identical" if is_identical else "scored", "reason": None}
        yield pair.part("metrics", [row], is_whole=False)
    if not pair.drawn_matches:
        yield pair.part("metrics", [], is_whole=False)


def baselines(pair: StoredPair) -> Parts:
    """Baseline metrics of the drawn objects, and of the whole scans."""
    chosen = [metric for metric in BASELINES if metric.method in pair.settings.metrics.baselines]
    if not chosen:
        return
    of_scans = [metric for metric in chosen if metric.method not in _OF_OBJECTS]
    names = [((row["real_id"], row["sim_id"]), metric) for row in pair.matched for metric in chosen]
    names += [((-1, -1), metric) for metric in of_scans]
    named = [
        {"real_id": ids[0], "sim_id": ids[1], "baseline": metric.column, "unit": METRIC[metric.column].unit or None}
        for ids, metric in names
    ]
    yield pair.part("baselines", named)
    drawn = [((row["real_id"], row["sim_id"]), _distances(pair, row), chosen) for row in pair.drawn_matches]
    if pair.sample.whole_sides:
        real, sim = (pair.sides[side].points for side in SIDES)
        whole = distances.of_points(real, sim, pair.settings.metrics.model_dump())
        drawn.append(((-1, -1), whole, of_scans))
    expected = []
    for (real_id, sim_id), values_, metrics_ in drawn:
        for name in (metric.column for metric in metrics_):
            if name in values_:
                expected.append({"real_id": real_id, "sim_id": sim_id, "baseline": name, "value": values_[name]})
            else:
                yield Skipped(f"baseline {name}: not in the literal twin")
    yield pair.part("baselines", expected, is_whole=False)


def _distances(pair: StoredPair, match: Row) -> dict[str, float | None]:
    """Baseline metrics of a matched object by name, as far as the literal twin has them."""
    settings, members, kept = pair.settings.metrics.model_dump(), pair.members(match), pair.kept(match)
    real, sim = (pair.sides[side].points[members[side]] for side in SIDES)
    a, b = (pair.sides[side].points[kept[side]] for side in SIDES)
    expected = distances.of_points(real, sim, settings)
    expected["emd_centred_mean_m"] = float(np.linalg.norm((a - a.mean(axis=0)) - (b - b.mean(axis=0)), axis=1).mean())
    n_most = max(len(real), len(sim))
    if n_most > MOST_NODES:
        return expected
    expected["emd_kept_mean_m"] = distances.assignment_mean(a, b)
    if len(real) == len(sim) <= settings["emd_max_points"]:
        expected["emd_mean_m"] = distances.assignment_mean(real, sim)
    A_real, A_sim = (pair.sides[side].matrix(members[side]) for side in SIDES)
    expected["netlsd"] = distances.netlsd(A_real, A_sim, settings) if n_most <= settings["heat_max_nodes"] else None
    expected["r_h"] = None
    if len(a) >= _FEWEST_FOR_SPECTRA:
        L_real, L_sim = (literal_method.laplacian(pair.sides[side].matrix(kept[side])) for side in SIDES)
        change = literal_method.spectral(L_real, L_sim)["laplacian_change"]
        expected["r_h"] = distances.r_h(L_real, L_sim, pair.settings.selection.t, change)
    return expected


def seeds(pair: StoredPair) -> Parts:
    """Scores of the configured seed, which are those of the pair; those of other seeds are not recomputed."""
    n_seeds, first = pair.settings.stability.seeds, pair.settings.communities.seed
    if n_seeds == 1:
        return
    yield pair.part("seeds", {"seed": range(first, first + n_seeds)})
    columns = [name for name in TABLES["seeds"].schema.names if name not in ("pair_id", "seed")]
    row = {name: pair.row[name] for name in columns}
    yield pair.part("seeds", [row | {"seed": first}], is_whole=False)
    yield Skipped("scores under other seeds of the communities")


def pairs(pair: StoredPair) -> Parts:
    """Row of the pair: counts, match rate, means, deviations and medians over its objects."""
    n = dict.fromkeys(("matched", *UNMATCHED.values()), 0)
    ranges = {side: pair.table("objects", side)["range_m"].to_numpy() for side in SIDES}
    matched: list[float] = []
    unmatched: list[float] = []
    for own in pair.matching:
        n[own["status"]] += 1
        side = "sim" if own["status"] == "hallucinated" else "real"
        (matched if own["status"] == "matched" else unmatched).append(float(ranges[side][own[f"{side}_id"]]))
    expected: Row = {f"n_{name}": count for name, count in n.items()}
    table = pair.table("metrics")
    expected |= {f"n_{kind}": int((table["status"] == kind).sum()) for kind in ("scored", "identical", "too_small")}
    expected |= {f"n_communities_{side}": n["matched"] + n[unmatched_] for side, unmatched_ in UNMATCHED.items()}
    expected["match_rate"] = n["matched"] / (n["matched"] + max(n["missing"], n["hallucinated"]))
    expected["found"] = n["matched"] / (n["matched"] + n["missing"])
    expected["median_range_matched_m"] = float(np.median(matched)) if matched else None
    expected["median_range_unmatched_m"] = float(np.median(unmatched)) if unmatched else None
    for name in OBJECT_METRICS:
        own_values = [None if math.isnan(value) else value for value in table[name].astype(float).tolist()]
        expected[f"{name}_mean"], expected[f"{name}_std"] = literal_method.mean_and_std(own_values)
    yield pair.in_pairs(expected | {"pair_id": pair.pair_id, "status": "scored"})
    yield values("pairs", {"no reason": pair.row["reason"] or ""}, {"no reason": ""})


#: Recomputation by table, in the order of the stages; stage of the table if it has another name.
RECOMPUTED: dict[str, Callable[[StoredPair], Parts]] = {
    one.__name__: one
    for one in (
        *(rows, scan, ground, sensor, graph, communities, objects, matching, coverage, surface, pieces, rays),
        *(selection, metrics, baselines, seeds, nvs, pairs),
    )
}
