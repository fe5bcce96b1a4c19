"""Recomputation of the tables of a pair as data frames: each from the stored tables before it, by `stages.literal`.

If ties or rounding allow several correct answers, the stored one is accepted if it is one of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.distance import cdist

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import BASELINES, COVERAGE_REACHES, OBJECT_METRICS, SHIFT_COLUMNS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IndexArray
from ...stages.clean import as_ros
from ...stages.literal import literal_baselines as distances
from ...stages.literal import literal_method, literal_pieces, literal_surfaces
from ...stages.sensor_description import PAIR_COLUMNS, describe_sensor, sensor_row
from ..jobs import stages_under
from ..storage.run_record import library_versions
from .compare_frames import DEFAULT_TOLERANCE
from .recompute_rays import rays
from .stored import StoredPair, StoredSide, rows_of

#: Objects with more points are left out of checks that need dense matrices of all their nodes.
MOST_NODES = 3000
#: The relative and absolute difference that two ways of computing an influence may have.
_ROUNDING = 1e-11
_FEWEST_FOR_SPECTRA = 3
_FEWEST_FOR_PLANES = 20
_SAMPLE_POINTS = 2000
_NODES_PER_OBJECT = 3
_ROUGHNESS = ("roughness_real_m", "roughness_sim_m", "roughness_bias_m", "roughness_area_m")
_REACHES_M = dict(zip(COVERAGE_REACHES, (0.1, 0.3, 1.0), strict=True))
_FROM_SCANS = ("point_id", "x", "y", "z", "intensity", "label", "instance")
#: Baselines that need the graphs or the aligned nodes of an object.
_OF_OBJECTS = ("emd", "netlsd", "r_h")
UNMATCHED = {"real": "missing", "sim": "hallucinated"}
_FATES = ("matched", *UNMATCHED.values())
_KEYS = ["real_id", "sim_id"]


def rows(pair: StoredPair) -> None:
    """Names of pair and side in the rows of every table, and their order by the keys, without duplicates."""
    stages = stages_under(pair.settings)
    for table, side in [(table, side) for stage in stages for side in stage.parts for table in stage.gives]:
        frame = pair.table(table, side)
        names = {"pair_id": pair.pair_id} | ({"side": side} if side else {})
        stored: Row = {f"{table}.{name}": int((frame[name] != own).sum()) for name, own in names.items()}
        keys = pd.MultiIndex.from_frame(frame[[*TABLES[table].keys]].replace(-1, np.inf))  # nulls last
        is_in_order = keys.is_unique and keys.is_monotonic_increasing
        stored[f"rows of {table} not in order, or twice"] = int(not is_in_order)
        pair.compare_values("rows", stored, dict.fromkeys(stored, 0), side)


def scan(pair: StoredPair) -> None:
    """Points that cleaning keeps, one by one."""
    settings = pair.settings.input
    for side in SIDES:
        read = pair.scan(side)
        if read is None:
            pair.tally.skip("", "sensor", *(f"ground.{name}" for name in _FROM_SCANS), f"pairs.n_{side}_raw")
            continue
        transform = pair.scans.T_real_sim if pair.scans and side == "sim" else None
        T = np.array(transform).reshape(3, 4) if transform else None
        kept, points = literal_method.clean(read.points, settings.model_dump(), settings.frame_of(side), T)
        frame = {"point_id": np.array(kept, dtype=np.intp), **dict(zip("xyz", points.T, strict=True))}
        for name, own in (("intensity", read.intensity), ("instance", read.instances), ("label", read.labels)):
            frame[name] = None if own is None else own[kept]
        pair.compare("scan", frame, side)
        pair.compare_row({f"n_{side}_raw": len(read.points)})


def ground(pair: StoredPair) -> None:
    """Heights and flags of all clean points, and the cut."""
    settings = pair.settings.ground
    for side in SIDES:
        stored, metadata = pair.table("ground", side), {**pair.metadata("ground", side)}
        cut, heights, is_clear = _cut(pair, side)
        frame = {"point_id": stored["point_id"].to_numpy(), "height_m": heights - cut["peak_m"]}
        if settings.method == "patchwork":
            why = "flags of ground by patchwork++: fidpipe has no second implementation"
            pair.tally.skip(why, "ground.is_ground")
        else:
            threshold_m = -np.inf if cut["threshold_m"] is None else cut["threshold_m"]
            is_close = np.abs(heights - threshold_m) <= DEFAULT_TOLERANCE
            frame["is_ground"] = np.where(is_close, stored["is_ground"], heights < threshold_m)
        pair.compare("ground", frame, side, is_whole=False)
        n_ground, axis = int(stored["is_ground"].sum()), cut.pop("axis")
        pair.compare_row({f"n_{side}_clean": len(stored), f"n_{side}_points": len(stored) - n_ground})
        cut["removed_share"] = n_ground / len(stored)
        if not is_clear:
            column = f"pairs.ground_{side}_tilt_deg"
            pair.tally.skip("tilt of a scan with equal variance along two axes", column)
            del cut["tilt_deg"]
        pair.compare_row({f"ground_{side}_{name}": value for name, value in cut.items()})
        cut |= {f"axis {name}": value for name, value in zip("xyz", axis, strict=True)}
        metadata |= {f"axis {name}": value for name, value in zip("xyz", metadata["axis"], strict=True)}
        noted, expected = ({f"metadata {name}": own[name] for name in cut} for own in (metadata, cut))
        pair.compare_values("ground", noted, expected, side)


def _cut(pair: StoredPair, side: str) -> tuple[literal_method.Cut, FloatArray, bool]:
    """Cut of a side from its metadata, heights of its points, and True if the points determine the axis."""
    settings, points = pair.settings.ground, pair.sides[side].all_points
    axis = np.array(pair.metadata("ground", side)["axis"])
    cut, heights, is_unique = literal_method.ground(points, settings.model_dump(), axis)
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
    return cut, heights, is_unique


def sensor(pair: StoredPair) -> None:
    """Description of both sensors, by the same code."""
    for side in SIDES:
        stored = pair.table("sensor", side)
        pair.compare_row({f"sensor_{side}_{name.removeprefix('n_')}": stored[name][0] for name in PAIR_COLUMNS})
        read = pair.scan(side)
        if read is not None:
            points = as_ros(read.points, pair.settings.input.frame_of(side))
            row = sensor_row(describe_sensor(points, read.rings, read.times_s is not None))
            pair.compare("sensor", [row | {"side": side}], side)


def graph(pair: StoredPair) -> None:
    """Length of every edge, and edges of some nodes."""
    for side, own in pair.sides.items():
        src, dst, _ = own.edges
        nodes = np.arange(len(own.points)) if pair.all_nodes else _drawn_nodes(pair, side)
        is_looked_at = np.isin(src, nodes) | np.isin(dst, nodes)
        edges = sorted({edge for node in nodes.tolist() for edge in _edges_of(pair, own, node)})
        found = np.array(edges, dtype=np.intp).reshape(-1, 2).T
        of_nodes, expected = (
            pd.DataFrame(dict(zip(("src", "dst"), own.point_ids[ends], strict=True))).set_index(["src", "dst"])
            for ends in (np.stack([src, dst])[:, is_looked_at], found)
        )
        pair.tally.compare("graph", of_nodes, expected, pair_id=pair.pair_id, side=side)
        length_m = literal_method.distances(own.points[dst], own.points[src]).astype(np.float32)
        pair.compare("graph", pair.table("graph", side)[["src", "dst"]].assign(length_m=length_m), side, is_whole=False)


def _drawn_nodes(pair: StoredPair, side: str) -> IndexArray:
    """Random nodes of the drawn objects of a side."""
    nodes: list[int] = []
    for community in pair.drawn_ids(side):
        members = pair.sides[side].members(community)
        nodes += pair.rng.choice(members, min(_NODES_PER_OBJECT, len(members)), replace=False).tolist()
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


def communities(pair: StoredPair) -> None:
    """Object of every object point: by Louvain's method, or that of the nearest real point."""
    for side, own in pair.sides.items():
        is_copied = pair.settings.communities.objects == "reference" and side == "sim"
        labels = _reference_labels(pair, own) if is_copied else _own_labels(pair, own)
        pair.compare("communities", {"point_id": own.point_ids, "community_id": labels}, side)


def _own_labels(pair: StoredPair, own: StoredSide) -> list[int]:
    """Object of each point of a side that is partitioned on its own."""
    settings, n, has_lengths = pair.settings.communities, len(own.points), own.edges[2].any()
    is_reference = settings.objects == "reference"
    order = literal_surfaces.visiting_order(own.points, settings.seed) if is_reference else list(range(n))
    stored = literal_method.canonical(own.labels, order)
    if is_reference and settings.reference != "louvain":
        pair.tally.skip(f"objects by {settings.reference} of the input")
        return stored
    if not has_lengths:
        pair.tally.skip("connected components of a graph without lengths")
        return stored
    gain = max(0.0, literal_method.best_merge_gain(own.labels, *own.edges))
    what = "modularity gained by joining two communities"
    pair.compare_values("communities", {what: gain}, {what: 0.0}, own.side)
    name = "scikit-network"
    if settings.backend != name or pair.run.record.libraries.get(name) != library_versions([name])[name]:
        pair.tally.skip(f"communities of a graph by another Louvain than that of the installed {name}")
        return stored
    visits = order if is_reference else np.random.RandomState(settings.seed).permutation(n)
    return literal_method.canonical(literal_method.louvain(n, *own.edges, np.array(visits)), order)


def _reference_labels(pair: StoredPair, own: StoredSide) -> IndexArray:
    """Object of each simulated point: that of the nearest real point, or out of reach a separate one.

    For equal distances any of the points is accepted. Points of objects that are not drawn are copied, unless both
    sides are compared as a whole.
    """
    settings, real, stored = pair.settings.communities, pair.sides["real"], own.labels
    n_real, expected, sizes = int(real.labels.max()) + 1, own.labels.copy(), np.bincount(stored[stored >= 0])

    def number(points: IndexArray, groups: Any) -> IndexArray:
        order = literal_surfaces.visiting_order(own.points[points], settings.seed)
        return np.array(literal_method.canonical(groups, order), dtype=np.intp)

    hallucinated = np.flatnonzero(stored >= n_real)
    expected[hallucinated] = n_real + number(hallucinated, stored[hallucinated])
    checked = {i for community in pair.drawn_ids("sim") for i in own.members(community).tolist()}
    if pair.whole_sides:
        outside = np.flatnonzero(literal_method.nearest_distances(own.points, real.points) > settings.reach_m)
        groups = number(outside, literal_pieces.components(own.points[outside], pair.settings.pieces.link_m))
        is_object = np.bincount(groups)[groups] >= settings.min_points
        expected[outside[is_object]] = n_real + groups[is_object]
        checked = (checked | {*hallucinated.tolist()}) - {*outside[is_object].tolist()}
    for i in checked:
        apart = literal_method.distances(real.points, own.points[i])
        near = real.labels[apart <= apart.min() * (1 + 1e-12)]
        is_out_of_reach = (
            stored[i] >= n_real and sizes[stored[i]] >= settings.min_points and apart.min() > settings.reach_m
        )
        if stored[i] not in near and (pair.whole_sides or not is_out_of_reach):
            expected[i] = near[0]
    return expected


def objects(pair: StoredPair) -> None:
    """Number of points of every object; place, size, shape and label of the drawn ones."""
    for side, own in pair.sides.items():
        pair.compare("objects", {"community_id": range(len(own.sizes)), "n_points": own.sizes}, side)
        labels = pair.table("ground", side)["label"][own.is_object]
        drawn: list[Row] = []
        for community in pair.drawn_ids(side):
            members = own.members(community)
            about: Row = dict.fromkeys((*literal_method.PLACE, *literal_method.SHAPE)) | {"n_points": 0}
            about |= literal_method.describe(own.points[members]) if len(members) else {}
            drawn.append({"community_id": community, "label": _most_frequent(labels.iloc[members])} | about)
        pair.compare("objects", drawn, side, is_whole=False)


def _most_frequent(labels: pd.Series[Any]) -> str | None:
    """Most frequent label, for equal counts the first in the alphabet; None if all are null."""
    counts = labels.value_counts().sort_index()
    return str(counts.idxmax()) if len(counts) else None


def matching(pair: StoredPair) -> None:
    """Matches of all objects."""
    tables = {side: pair.table("objects", side) for side in SIDES}
    real, sim = (tables[side][["cx", "cy", "cz"]].to_numpy() for side in SIDES)
    settings, of_reference = pair.settings.matching, pair.settings.communities.objects == "reference"
    pairs = dict(zip(pair.matches["real_id"].tolist(), pair.matches["sim_id"].tolist(), strict=True))
    if of_reference:
        n_real, n_sim = (tables[side]["n_points"].to_numpy() for side in SIDES)
        least = np.minimum(pair.settings.communities.min_points, n_real)
        pairs = {i: i for i in np.flatnonzero(n_sim[: len(real)] >= least).tolist()}
    elif settings.method == "greedy":
        found = literal_method.match_greedy(real, sim, settings.delta_m, pairs, DEFAULT_TOLERANCE)
        pairs = {i: j for i, j, _ in found}
    else:
        _compare_optimum(pair, real, sim, pairs, settings.delta_m)
    missing = [i for i in range(len(real)) if i not in pairs]
    first = len(real) if of_reference else 0  # a missing object of the reference may have simulated points
    unmatched = [j for j in range(first, len(sim)) if j not in pairs.values()]
    expected = [
        *((i, j, "matched", math.dist(real[i], sim[j])) for i, j in sorted(pairs.items())),
        *((i, -1, "missing", None) for i in missing),
        *((-1, j, "hallucinated", None) for j in unmatched),
    ]
    columns = ("real_id", "sim_id", "status", "centroid_distance_m")
    pair.compare("matching", [dict(zip(columns, row, strict=True)) for row in expected])


def _compare_optimum(
    pair: StoredPair, real: FloatArray, sim: FloatArray, pairs: dict[int, int], delta_m: float
) -> None:
    """Compare number and mean distance of the stored matches below delta with those of an optimal matching."""
    n, least = max(len(real), len(sim)), min(len(real), len(sim))
    apart, forbidden = cdist(real, sim), delta_m * (least + 1)
    cost = np.zeros((n, n))
    cost[: len(real), : len(sim)] = np.where(apart < delta_m, apart, forbidden)
    matched = [apart[i, j] for i, j in pairs.items()]
    total = math.fsum(matched) + (least - len(pairs)) * forbidden
    stored = {"mean distance, m": total / n, "matches nearer than delta": sum(m < delta_m for m in matched)}
    expected = (literal_method.least_total(cost) / n, len(pairs))
    pair.compare_values("matching", stored, dict(zip(stored, expected, strict=True)))


def coverage(pair: StoredPair) -> None:
    """Coverage of each drawn object; for whole sides the mean over their objects."""
    shares = [*(f"covered_{reach}" for reach in COVERAGE_REACHES), "road_share"]
    sizes, expected = [], []
    for side, other in (SIDES, SIDES[::-1]):
        own, others, cut = pair.sides[side], pair.sides[other].points, pair.metadata("ground", other)
        of_side: Row = {"side": side}
        sizes += [of_side | {"community_id": i, "n_points": n} for i, n in enumerate(own.sizes.tolist())]
        sizes.append(of_side | {"community_id": -1, "n_points": len(own.points)})
        drawn = {community: own.members(community) for community in pair.drawn_ids(side)}
        drawn |= {-1: np.arange(len(own.points))} if pair.whole_sides else {}
        for community, members in drawn.items():
            expected.append(of_side | {"community_id": community} | _covered(own.points[members], others, cut))
        stored = pair.table("coverage").query("side == @side")
        whole = stored[stored["community_id"] == -1].iloc[0]
        pair.compare_row({f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in COVERAGE_REACHES})
        if (own.labels < 0).any():
            pair.tally.skip("coverage of a whole side as the mean of its objects, if some points belong to none")
            continue
        parts = stored[(stored["community_id"] >= 0) & (stored["n_points"] > 0)]
        total = parts[shares].astype(float).mul(parts["n_points"], axis=0).sum(skipna=False)
        mean = of_side | {"community_id": -1} | (total / parts["n_points"].sum()).to_dict()
        pair.compare("coverage", [mean], is_whole=False)
    pair.compare("coverage", sizes)
    pair.compare("coverage", expected, is_whole=False)


def _covered(points: FloatArray, others: FloatArray, cut: Row) -> Row:
    """Covered shares of points, their median distance from the other side, and the share below its cut."""
    if not len(points):
        return dict.fromkeys((*(f"covered_{reach}" for reach in _REACHES_M), "median_distance_m", "road_share"))
    apart = literal_method.nearest_distances(points, others).tolist()
    row: Row = {
        f"covered_{reach}": sum(d <= reach_m for d in apart) / len(apart) for reach, reach_m in _REACHES_M.items()
    }
    row |= {"median_distance_m": float(np.median(apart)), "road_share": None}
    if cut["threshold_m"] is not None:
        heights = [float(p @ np.array(cut["axis"])) for p in points]
        row["road_share"] = sum(h < cut["threshold_m"] for h in heights) / len(heights)
    return row


def surface(pair: StoredPair) -> None:
    """Displacement of the surfaces of the drawn real objects; for whole sides also the roughness."""
    stored = pair.table("surface").set_index("real_id")
    pair.compare("surface", {"real_id": [*range(len(pair.table("objects", "real"))), -1]})
    pair.compare_row({column: stored.loc[-1, column] for column in SHIFT_COLUMNS})
    planes, of_sim = (_planes(pair, side) for side in SIDES)
    labels = pair.sides["real"].labels
    drawn = {community: [planes[i] for i in planes if labels[i] == community] for community in pair.drawn_ids("real")}
    drawn |= {-1: [*planes.values()]} if pair.whole_sides else {}
    expected = []
    for community, own in drawn.items():
        if any(plane.is_tied for plane in own):
            pair.tally.skip("displacement of an object with ties among the neighbours of its points", "surface")
        else:
            expected.append({"real_id": community} | literal_surfaces.offset(own, pair.sides["sim"].points))
    pair.compare("surface", expected, is_whole=False)
    if not pair.whole_sides:
        return
    if any(plane.is_tied for plane in (*planes.values(), *of_sim.values())):
        why = "roughness of a pair with ties among the neighbours of its points"
        pair.tally.skip(why, *(f"pairs.{name}" for name in _ROUGHNESS))
        return
    roughness: Row = dict.fromkeys(_ROUGHNESS)
    if planes and of_sim:
        a, b = (np.array([plane.roughness_m for plane in own.values()]) for own in (planes, of_sim))
        bias = float(b.mean() - a.mean())
        area = literal_surfaces.area_between(a.tolist(), (b - bias).tolist())
        roughness = dict(zip(_ROUGHNESS, (float(np.median(a)), float(np.median(b)), bias, area), strict=True))
    pair.compare_row(roughness)


def _planes(pair: StoredPair, side: str) -> dict[int, literal_surfaces.Plane]:
    """Planes at sampled points by index: of drawn real objects; of both sides if they are compared as a whole."""
    own = pair.sides[side]
    if len(own.points) < _FEWEST_FOR_PLANES or (side == "sim" and not pair.whole_sides):
        return {}
    sample, drawn = literal_surfaces.visiting_order(own.points)[:_SAMPLE_POINTS], set(pair.drawn_ids(side))
    chosen = [i for i in sample if pair.whole_sides or own.labels[i] in drawn]
    return {i: literal_surfaces.local_plane(own.points, own.points[i]) for i in chosen}


def pieces(pair: StoredPair) -> None:
    """Numbers, shares and moves of the stored pieces; for whole sides the pieces themselves."""
    if pair.whole_sides:
        pair.compare("pieces", [row for sides in (SIDES, SIDES[::-1]) for row in _pieces(pair, *sides)])
    else:
        pair.tally.skip("", "pieces")
    stored = pair.table("pieces")
    of_side = {side: stored[stored["side"] == side] for side in SIDES}
    for side, word in (("real", "missing"), ("sim", "invented")):
        share = of_side[side]["n_points"].sum() / len(pair.sides[side].points)
        pair.compare_row({f"n_{word}_pieces": len(of_side[side]), f"{word}_pieces_share": share})
    fates = literal_pieces.fates(rows_of(of_side["real"]), rows_of(of_side["sim"]))
    pair.compare("pieces", fates, is_whole=False)


def _pieces(pair: StoredPair, side: str, other: str) -> list[Row]:
    """Recomputed pieces of a side."""
    own, settings, table = pair.sides[side], pair.settings.pieces.model_dump(), pair.table("ground", side)
    others, heights = pair.sides[other].all_points, table["height_m"].to_numpy()
    return [
        row | {"side": side, "label": _most_frequent(table["label"].iloc[members])}
        for members, row in literal_pieces.pieces(own.all_points, ~own.is_object, heights, others, settings)
    ]


def selection(pair: StoredPair) -> None:
    """Number of aligned nodes of every object; for the drawn ones the nodes, their influence and alignment."""
    ranks = pair.matches.loc[pair.matches.index.repeat(pair.matches["n_keep"]), _KEYS]
    pair.compare("selection", ranks.assign(rank=ranks.groupby(level=0).cumcount()))
    expected: list[Row] = []
    for match in pair.drawn_matches:
        members, own = pair.members(match), {name: match[name] for name in _KEYS}
        if max(len(nodes) for nodes in members.values()) > MOST_NODES:
            columns = (f"selection.{side}_{what}" for side in SIDES for what in ("point_id", "influence"))
            why = f"influence and scores of an object of more than {MOST_NODES} points (dense matrices)"
            pair.tally.skip(why, *columns)
            continue
        rows = [own | {"rank": k} for k in range(match["n_keep"])]
        for side in SIDES:
            for row, (node, influence) in zip(rows, _selected(pair, match, side, members[side]), strict=True):
                row |= {f"{side}_point_id": pair.sides[side].point_ids[node], f"{side}_influence": influence}
        expected += rows
        (a, b), what = pair.points(pair.kept(match)), "mean distance of aligned nodes, m"
        cost = cdist(a - a.mean(axis=0), b - b.mean(axis=0))
        least = literal_method.least_total(cost) / len(cost)
        pair.compare_values("selection", {what: math.fsum(np.diag(cost)) / len(cost)}, {what: least}, **own)
    pair.compare("selection", expected, is_whole=False)


def _selected(pair: StoredPair, match: Row, side: str, members: IndexArray) -> list[tuple[int, float]]:
    """Kept nodes of a side of an object, by rank, and their influence.

    The stored nodes are accepted if no other node has more influence, up to rounding; the real ones in the order of
    their influence.
    """
    own, rows, n_keep = pair.sides[side], pair.selected(match), match["n_keep"]
    expected = literal_method.influence(own.laplacian(members), pair.settings.selection.t)
    of_node = dict(zip(members.tolist(), expected.tolist(), strict=True))
    chosen, stored = own.index(rows[f"{side}_point_id"]).tolist(), rows[f"{side}_influence"].tolist()
    precedence = sorted((-value, node) for value, node in zip(stored, chosen, strict=True))
    left_out = of_node.keys() - set(chosen)
    is_right = len(set(chosen)) == len(chosen) == n_keep and of_node.keys() >= set(chosen)
    if is_right and all((-round(of_node[i] * (1 - _ROUNDING) - _ROUNDING, 9), i) > precedence[-1] for i in left_out):
        nodes = [node for _, node in precedence] if side == "real" else chosen
    else:
        nodes = sorted(of_node, key=lambda i: (-round(of_node[i], 9), i))[:n_keep]
    return [(i, of_node[i]) for i in nodes]


def metrics(pair: StoredPair) -> None:
    """Scores of the drawn objects, from the nodes that the selection kept."""
    pair.compare("metrics", pair.matches)
    pair.compare("metrics", [], is_whole=False)
    for match in pair.drawn_matches:
        members, kept = pair.members(match), pair.kept(match)
        row: Row = {name: match[name] for name in _KEYS}
        row["cdc"] = literal_method.cdc(*pair.points(members))
        row["alignment_rms_m"] = literal_method.alignment_rms(*pair.points(kept))
        n_keep = len(kept["real"])
        if n_keep > MOST_NODES:
            why = f"spectra of an object of more than {MOST_NODES} aligned nodes (dense matrices)"
            pair.tally.skip(why, *(f"metrics.{name}" for name in (*literal_method.SPECTRAL, "status", "reason")))
        elif n_keep < _FEWEST_FOR_SPECTRA:
            reason = f"{n_keep} aligned nodes, at least 3 are needed for a spectrum"
            row |= dict.fromkeys(literal_method.SPECTRAL) | {"status": "too_small", "reason": reason}
        else:
            row |= literal_method.spectral(*pair.laplacians(kept))
            is_identical = row["laplacian_change"] <= literal_method.IDENTICAL_CHANGE
            row |= {"status": "identical" if is_identical else "scored", "reason": None}
        pair.compare("metrics", [row], is_whole=False)


def baselines(pair: StoredPair) -> None:
    """Baseline metrics of the drawn objects, and of the whole scans."""
    chosen = [metric for metric in BASELINES if metric.method in pair.settings.metrics.baselines]
    if not chosen:
        return
    units = pd.DataFrame([{"baseline": metric.column, "unit": metric.unit or None} for metric in chosen])
    of_scans = units[[metric.method not in _OF_OBJECTS for metric in chosen]].assign(real_id=-1, sim_id=-1)
    pair.compare("baselines", pd.concat([pair.matches[_KEYS].merge(units, how="cross"), of_scans]))
    drawn = [(match["real_id"], match["sim_id"], units, _distances(pair, match)) for match in pair.drawn_matches]
    if pair.whole_sides:
        real, sim = (pair.sides[side].points for side in SIDES)
        drawn.append((-1, -1, of_scans, distances.of_points(real, sim, pair.settings.metrics.model_dump())))
    expected = []
    for real_id, sim_id, of_object, values in drawn:
        for name in of_object["baseline"]:
            if name in values:
                expected.append({"real_id": real_id, "sim_id": sim_id, "baseline": name, "value": values[name]})
            else:
                pair.tally.skip(f"baseline {name}: not in the literal twin")
    pair.compare("baselines", expected, is_whole=False)


def _distances(pair: StoredPair, match: Row) -> dict[str, float | None]:
    """Baseline metrics of a matched object by name, as far as the literal twin has them."""
    settings, members, kept = pair.settings.metrics.model_dump(), pair.members(match), pair.kept(match)
    (real, sim), (a, b) = pair.points(members), pair.points(kept)
    expected = distances.of_points(real, sim, settings)
    expected["emd_centred_mean_m"] = float(np.linalg.norm((a - a.mean(axis=0)) - (b - b.mean(axis=0)), axis=1).mean())
    n_most = max(len(real), len(sim))
    if n_most > MOST_NODES:
        return expected
    expected["emd_kept_mean_m"] = distances.assignment_mean(a, b)
    if len(real) == len(sim) <= settings["emd_max_points"]:
        expected["emd_mean_m"] = distances.assignment_mean(real, sim)
    expected |= {"netlsd": None, "r_h": None}
    if n_most <= settings["heat_max_nodes"]:
        expected["netlsd"] = distances.netlsd(*pair.laplacians(members), settings)
    if len(a) >= _FEWEST_FOR_SPECTRA:
        expected["r_h"] = distances.r_h(*pair.laplacians(kept), pair.settings.selection.t)
    return expected


def seeds(pair: StoredPair) -> None:
    """Scores of the configured seed, which are those of the pair; those of other seeds are not recomputed."""
    n_seeds, first = pair.settings.stability.seeds, pair.settings.communities.seed
    if n_seeds > 1:
        pair.compare("seeds", {"seed": range(first, first + n_seeds)})
        row = {name: pair.row[name] for name in TABLES["seeds"].schema.names if name not in ("pair_id", "seed")}
        pair.compare("seeds", [row | {"seed": first}], is_whole=False)
        pair.tally.skip("scores under other seeds of the communities")


def pairs(pair: StoredPair) -> None:
    """Row of the pair: counts, match rate, means, deviations and medians over its objects."""
    fates, scores = pair.table("matching"), pair.table("metrics")
    ranges = {side: pair.table("objects", side)["range_m"].to_numpy() for side in SIDES}
    n_matched, n_missing, n_hallucinated = n = [(fates["status"] == name).sum() for name in _FATES]
    expected: Row = {f"n_{name}": own for name, own in zip(_FATES, n, strict=True)}
    expected |= {f"n_{kind}": (scores["status"] == kind).sum() for kind in ("scored", "identical", "too_small")}
    expected |= {"n_communities_real": n_matched + n_missing, "n_communities_sim": n_matched + n_hallucinated}
    expected["match_rate"] = n_matched / (n_matched + max(n_missing, n_hallucinated))
    expected["found"] = n_matched / (n_matched + n_missing)
    of_fate = {name: fates[fates["status"] == name] for name in _FATES}
    matched_m = ranges["real"][of_fate["matched"]["real_id"]]
    unmatched_m = [m for side, name in UNMATCHED.items() for m in ranges[side][of_fate[name][f"{side}_id"]]]
    for word, own in (("matched", matched_m), ("unmatched", unmatched_m)):
        expected[f"median_range_{word}_m"] = float(np.median(own)) if len(own) else None
    summary = scores[[*OBJECT_METRICS]].astype(float).agg(["mean", "std"])
    expected |= {f"{name}_{what}": own[what] for name, own in summary.items() for what in summary.index}
    pair.compare_row(expected | {"pair_id": pair.pair_id, "status": "scored"})
    pair.compare_values("pairs", {"no reason": pair.row["reason"] or ""}, {"no reason": ""})


#: Recomputation by table, in the order of the stages; stage of the table if it has another name.
RECOMPUTED: dict[str, Callable[[StoredPair], None]] = {
    one.__name__: one
    for one in (
        *(rows, scan, ground, sensor, graph, communities, objects, matching, coverage, surface, pieces, rays),
        *(selection, metrics, baselines, seeds, pairs),
    )
}
