"""What the literal twin makes of each side: kept points, cut, edges, objects, and what the other side has of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import COVERAGE_REACHES, SHIFT_COLUMNS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IndexArray
from ...stages.clean import as_ros
from ...stages.inspect.sensor import PAIR_COLUMNS, describe_sensor, sensor_row
from ...stages.literal import method, pieces, surfaces
from ..datasets.readers import read_scan
from .comparisons import LENGTH_M, MODULARITY, Comparisons, point_names
from .stored import StoredPair, StoredSide

_NODES_PER_OBJECT = 3
_DESCRIBED = ("cx", "cy", "cz", "range_m", "extent_x", "extent_y", "extent_z", "linearity", "planarity", "scattering")
_SAMPLE_POINTS = 2000
_ROUGHNESS = ("real_m", "sim_m", "bias_m", "area_m")
_FEWEST_FOR_PLANES = 20
_SENSOR_WORDS = ("model", "reason")
#: What the scans tell, and nothing else.
_OF_SCANS = (
    *(f"ground.{name}" for name in ("point_id", "x", "y", "z", "intensity", "label", "instance")),
    *(f"pairs.n_{side}_raw" for side in SIDES),
)
_REACHES_M = dict(zip(COVERAGE_REACHES, (0.1, 0.3, 1.0), strict=True))


def check_rows(pair: StoredPair, comparisons: Comparisons) -> None:
    """That the rows of every table name this pair and this side, and ascend by their keys, none twice."""
    for table, side in pair.tables:
        stored, place = pair.columns(table, side), pair.place("rows", side)
        for name, own in {"pair_id": pair.pair_id, "side": side}.items() if side else [("pair_id", pair.pair_id)]:
            n_others = int(np.count_nonzero(stored[name] != own))
            comparisons.compare(place, f"{name} of {table}, others", n_others, 0, covers=[f"{table}.{name}"])
        n_rows = len(stored["pair_id"])
        is_after, is_same = np.zeros(max(0, n_rows - 1), dtype=bool), np.ones(max(0, n_rows - 1), dtype=bool)
        for key in TABLES[table].keys:
            values = stored[key]
            if values.dtype == object:
                values = np.unique(values, return_inverse=True)[1]
            before, after = (np.where(np.isnan(own), np.inf, own) for own in (values[:-1], values[1:]))  # nulls last
            is_after |= is_same & (before < after)
            is_same &= before == after
        comparisons.compare(place, f"rows of {table} not in order, or twice", (~is_after).sum(), 0)


def check_sensor(pair: StoredPair, comparisons: Comparisons) -> None:
    """The description of both sensors, by the same code; the columns of `pairs` against the table."""
    for side in SIDES:
        stored, place = pair.columns("sensor", side), pair.place("sensor", side)
        for name in PAIR_COLUMNS:
            column = f"sensor_{side}_{name.removeprefix('n_')}"
            comparisons.compare(pair.place("pairs"), column, pair.row[column], stored[name])
        path = None if pair.scans is None else pair.scans.path(side)
        if path is None:
            comparisons.excuse(["sensor"])
            continue
        settings = pair.settings.input
        scan = read_scan(path, settings.columns_of(side))
        sensor = describe_sensor(as_ros(scan.points, settings.frame_of(side)), scan.rings, scan.times_s is not None)
        for name, value in sensor_row(sensor).items():
            comparisons.compare(place, name, stored[name], value, tolerance=0.0 if name in _SENSOR_WORDS else LENGTH_M)


def check_scan(pair: StoredPair, comparisons: Comparisons) -> None:
    """Cleaning, where the scans are still there."""
    if pair.scans is None:
        comparisons.excuse(_OF_SCANS)
        return
    settings = pair.settings.input
    for side in SIDES:
        path = pair.scans.path(side)
        if path is None:
            continue
        scan = read_scan(path, settings.columns_of(side), pair.label_names)
        T = np.array(pair.scans.T_real_sim).reshape(3, 4) if side == "sim" and pair.scans.T_real_sim else None
        rows, points = method.clean(
            scan.points,
            settings.min_range_m,
            settings.max_range_m,
            settings.exclude_box,
            T,
            frame=settings.frame_of(side),
            include_box=settings.include_box,
        )
        place, ground = pair.place("scan", side), pair.columns("ground", side)
        comparisons.compare(pair.place("pairs"), f"n_{side}_raw", pair.row[f"n_{side}_raw"], len(scan.points))
        comparisons.compare(place, "point_id", ground["point_id"], rows)
        if len(rows) == len(ground["point_id"]):
            for axis, values in zip("xyz", points.T, strict=True):
                comparisons.compare(place, axis, ground[axis], values, tolerance=LENGTH_M, rows=point_names(rows))
            for name, own in (("intensity", scan.intensity), ("instance", scan.instances), ("label", scan.labels)):
                wanted = np.full(len(rows), None if name == "label" else np.nan) if own is None else own[rows]
                comparisons.compare(place, name, ground[name], wanted, rows=point_names(rows))


def check_ground(pair: StoredPair, comparisons: Comparisons) -> None:
    """The ground cut: heights and flags of all clean points, and what is told of the cut."""
    settings = pair.settings.ground
    real_facts = pair.facts("ground", "real")
    for side in SIDES:
        own, stored = pair.sides[side], pair.columns("ground", side)
        facts = pair.facts("ground", side)
        limits = (settings.prior_m, settings.max_variance_loss, settings.loss)
        cut = method.ground(own.all_points, *limits, if_not_told=np.array(facts["axis"]))
        axis, tilt_deg, peak_m = cut.axis, cut.tilt_deg, cut.peak_m
        threshold_m: float | None = cut.threshold_m
        loss: float | None = cut.loss
        iterations: int | None = cut.iterations
        height_m = cut.height_m
        offset_m = None
        if side == "sim" and (settings.shared or settings.peak == "real"):
            axis = np.array(real_facts["axis"])
            real_points = pair.sides["real"].all_points
            offset_m = 0.0 if settings.shared else method.road_offset(real_points, own.all_points, axis)
        if offset_m is None:
            axis = cut.axis
        else:
            tilt_deg, peak_m = real_facts["tilt_deg"], real_facts["peak_m"] + offset_m
            threshold_m, iterations = real_facts["threshold_m"], real_facts["iterations"]
            threshold_m = None if threshold_m is None else threshold_m + offset_m
            height_m = np.array([float(p @ axis) for p in own.all_points])
            loss = method.variance_loss(own.all_points, height_m, threshold_m or 0.0, peak_m, settings.loss)
        if settings.method != "pca":
            threshold_m = loss = iterations = None
        place, names = pair.place("ground", side), point_names(stored["point_id"])
        comparisons.compare(place, "height_m", stored["height_m"], height_m - peak_m, tolerance=LENGTH_M, rows=names)
        if settings.method == "patchwork":
            what = "flags of ground by patchwork++: there is no second implementation"
            comparisons.leave_out(what, ["ground.is_ground"])
        else:
            flags = np.zeros(len(height_m), dtype=bool) if threshold_m is None else height_m < threshold_m
            clear = np.ones(len(flags), dtype=bool) if threshold_m is None else abs(height_m - threshold_m) > LENGTH_M
            kept = stored["is_ground"].astype(bool)
            rows = [name for name, is_clear in zip(names, clear, strict=True) if is_clear]
            comparisons.compare(place, "is_ground", kept[clear].astype(float), flags[clear].astype(float), rows=rows)
        n_ground = int(stored["is_ground"].sum())
        for i, coordinate in enumerate("xyz"):
            comparisons.compare(place, f"axis {coordinate}", facts["axis"][i], axis[i], tolerance=LENGTH_M)
        told = {
            "peak_m": peak_m,
            "threshold_m": threshold_m,
            "loss": loss,
            "iterations": iterations,
            "tilt_deg": tilt_deg,
            "removed_share": n_ground / len(height_m),
        }
        counts = {"clean": len(height_m), "points": len(height_m) - n_ground}
        for name, value in told.items():
            column = f"ground_{side}_{name}"
            if name == "tilt_deg" and not cut.is_told:
                comparisons.leave_out("tilt of a scan that spreads alike along two axes", [f"pairs.{column}"])
                continue
            # the arccosine is steep where the axis is upright
            tolerance = 1e-5 if name == "tilt_deg" else LENGTH_M
            comparisons.compare(pair.place("pairs"), column, pair.row[column], value, tolerance=tolerance)
            comparisons.compare(place, f"fact {name}", facts[name], value, tolerance=tolerance)
        for name, count in counts.items():
            comparisons.compare(pair.place("pairs"), f"n_{side}_{name}", pair.row[f"n_{side}_{name}"], count)


def check_graph(pair: StoredPair, comparisons: Comparisons) -> None:
    """The length of every edge, and of some nodes every edge: none too few, none too many."""
    settings = pair.settings.graph
    for side, own in pair.sides.items():
        place, points, ids = pair.place("graph", side), own.points, own.point_ids
        src, dst, length = own.edges
        apart = np.sqrt(((points[src] - points[dst]) ** 2).sum(axis=1)).astype(np.float32)
        exact = pair.columns("graph", side)["length_m"]
        unequal = np.flatnonzero(exact != apart)
        again = [
            method.distances(points[j : j + 1], points[i])[0] for i, j in zip(src[unequal], dst[unequal], strict=True)
        ]
        apart[unequal] = again  # one operation after the other, where the last bit counts
        comparisons.compare(place, "length_m", length, apart.astype(np.float64), rows=_EdgeNames(ids[src], ids[dst]))
        comparisons.compare(place, "src below dst, ascending", _is_ascending(src, dst, len(points)), True)
        nodes = np.arange(len(points)) if pair.drawn.all_nodes else _drawn_nodes(pair, side)
        for i in nodes.tolist():
            distance = method.distances(points, points[i])
            within = set(np.flatnonzero(distance <= settings.tau_m).tolist()) - {i}
            wanted = own.nearest(i) | within if settings.edges == "union" else own.nearest(i) & within
            stored = own.neighbours(i)
            surplus = {
                j
                for j in stored - wanted
                if i not in own.nearest(j) or (settings.edges == "intersection" and j not in within)
            }
            both = sorted(stored | wanted)
            names = [f"point {ids[i]} to {ids[j]}" for j in both]
            is_stored = [float(j in stored) for j in both]
            is_wanted = [float(j in wanted or (j in stored and j not in surplus)) for j in both]
            comparisons.compare(place, "edge", is_stored, is_wanted, rows=names, covers=("graph.src", "graph.dst"))


def _drawn_nodes(pair: StoredPair, side: str) -> IndexArray:
    """Some nodes of the drawn objects of a side."""
    nodes = []
    for community in pair.drawn_ids(side):
        members = pair.sides[side].members(community)
        nodes += pair.drawn.rng.choice(members, min(_NODES_PER_OBJECT, len(members)), replace=False).tolist()
    return np.array(nodes, dtype=np.intp)


def check_communities(pair: StoredPair, comparisons: Comparisons) -> None:
    """That every object point has the object that Louvain's method, or the nearest real point, gives it."""
    settings = pair.settings.communities
    is_reference = settings.objects == "reference"
    for side, own in pair.sides.items():
        place = pair.place("communities", side)
        comparisons.compare(place, "point_id", pair.columns("communities", side)["point_id"], own.point_ids)
        if is_reference and side == "sim":
            _compare_reference(pair, own, comparisons)
            continue
        order = np.array(surfaces.visiting_order(own.points, settings.seed) if is_reference else range(len(own.points)))
        in_object = order[own.labels[order] >= 0]
        made = np.full(len(own.points), -1, dtype=np.intp)
        made[in_object] = method.canonical(own.labels[in_object].tolist())
        comparisons.compare(place, "community_id", own.labels, made, rows=point_names(own.point_ids))
        if is_reference and settings.reference != "louvain":
            comparisons.leave_out(f"which points are one object by their {settings.reference}")
            continue
        if own.edges[2].any():
            gain = max(0.0, method.best_joining(own.labels, *own.edges))
            comparisons.compare(place, "modularity gained by joining two communities", gain, 0.0, tolerance=MODULARITY)
        visits = order if is_reference else np.random.RandomState(settings.seed).permutation(len(own.points))
        found = _louvain(pair, own.edges, visits, comparisons)
        if found is not None:
            names = point_names(own.point_ids)
            comparisons.compare(place, "community_id", own.labels, _canonical(found, order), rows=names)


def _compare_reference(pair: StoredPair, own: StoredSide, comparisons: Comparisons) -> None:
    """Whether simulated points have the object of the nearest real point, or, out of reach, one of their own."""
    settings, real, labels = pair.settings.communities, pair.sides["real"], own.labels
    n_real, place, ids = int(real.labels.max()) + 1, pair.place("communities", own.side), own.point_ids
    sizes = np.bincount(labels[labels >= 0])
    for community in pair.drawn_ids(own.side):
        for i in own.members(community).tolist():
            apart = method.distances(real.points, own.points[i])
            near = real.labels[apart <= apart.min() * (1 + 1e-12)]  # of several, if equally near but for rounding
            is_alone = community >= n_real and sizes[community] >= settings.min_points
            is_right = community in near or (is_alone and apart.min() > settings.reach_m)
            name = f"community_id of point {ids[i]}"
            comparisons.compare(place, name, community, community if is_right else int(near[0]))
    alone = np.flatnonzero(labels >= n_real)
    order = np.array(surfaces.visiting_order(own.points[alone], settings.seed), dtype=np.intp)
    numbered = n_real + _canonical(labels[alone], order)
    comparisons.compare(place, "community_id", labels[alone], numbered, rows=point_names(ids[alone]))
    if not pair.drawn.whole_sides:
        return
    outside = np.flatnonzero(method.nearest_distances(own.points, real.points) > settings.reach_m)
    order = np.array(surfaces.visiting_order(own.points[outside], settings.seed), dtype=np.intp)
    groups = _canonical(np.array(pieces.components(own.points[outside], pair.settings.pieces.link_m)), order)
    is_object = np.bincount(groups)[groups] >= settings.min_points
    made, stored = (np.full(len(labels), "of a real object", dtype=object) for _ in range(2))
    made[outside[is_object]] = [f"{n_real + group}" for group in groups[is_object]]
    stored[alone] = [f"{label}" for label in labels[alone]]
    comparisons.compare(place, "community_id", stored, made, rows=point_names(ids))


def _louvain(
    pair: StoredPair, edges: tuple[IndexArray, IndexArray, FloatArray], order: IndexArray, comparisons: Comparisons
) -> IndexArray | None:
    """What Louvain's method makes of a graph; None where another library, or version of it, was used in the run."""
    if pair.settings.communities.backend != "scikit-network" or not pair.has_same_library("scikit-network"):
        comparisons.leave_out("communities of a graph by another Louvain than that of the installed scikit-network")
        return None
    if not edges[2].any():
        comparisons.leave_out("the pieces of a graph without lengths")
        return None
    return np.array(method.louvain(len(order), *edges, order))


def _canonical(labels: IndexArray, order: IndexArray) -> IndexArray:
    """The same partition, numbered by size and then by the first of its points in an order."""
    numbered = np.empty(len(labels), dtype=np.intp)
    numbered[order] = method.canonical(labels[order].tolist())
    return numbered


def check_objects(pair: StoredPair, comparisons: Comparisons) -> None:
    """How many points every object has; where the drawn ones are, how large, of what shape."""
    for side, own in pair.sides.items():
        stored = pair.rows("objects", side)
        sizes = np.bincount(own.labels[own.labels >= 0], minlength=len(stored))
        place = pair.place("objects", side)
        comparisons.compare(place, "community_id", [row["community_id"] for row in stored], list(range(len(sizes))))
        comparisons.compare(
            place,
            "n_points",
            [row["n_points"] for row in stored],
            sizes,
            rows=[f"{side} {i}" for i in range(len(sizes))],
        )
        words = pair.columns("ground", side)["label"][own.is_object]
        for community in pair.drawn_ids(side):
            members = own.members(community)
            at, row = pair.place("objects", side, f"{side} {community}"), stored[community]
            made: list[float | None] = [None] * len(_DESCRIBED)
            if len(members):
                about = method.describe(own.points[members])
                made = [*about.centroid, about.range_m, *about.extent, *about.shape]
            for name, value in zip(_DESCRIBED, made, strict=True):
                comparisons.compare(at, name, row[name], value, tolerance=LENGTH_M)
            named = [word for word in words[members] if word is not None]
            label = min(set(named), key=lambda word: (-named.count(word), word)) if named else None
            comparisons.compare(at, "label", row["label"] or "", label or "")


def check_coverage(pair: StoredPair, comparisons: Comparisons) -> None:
    """What the other side has of each drawn object; of whole sides the mean of their objects."""
    rows = pair.rows("coverage")
    stored = {(row["side"], row["community_id"]): row for row in rows}
    sizes = {
        side: np.bincount(own.labels[own.labels >= 0], minlength=pair.n_objects(side)).tolist()
        for side, own in pair.sides.items()
    }
    wanted = [
        (side, i, n) for side in SIDES for i, n in [*enumerate(sizes[side]), (None, len(pair.sides[side].points))]
    ]
    for name, column in zip(("side", "community_id", "n_points"), zip(*wanted, strict=True), strict=True):
        comparisons.compare(pair.place("coverage"), name, [row[name] for row in rows], column)
    for side, other in (SIDES, SIDES[::-1]):
        own, others = pair.sides[side], pair.sides[other].points
        cut = pair.facts("ground", other)

        def compare(
            row: Row, members: IndexArray, name: str, own: StoredSide = own, others: FloatArray = others, cut: Any = cut
        ) -> None:
            at = pair.place("coverage", own.side, name)
            apart = method.nearest_distances(own.points[members], others).tolist()
            for reach, reach_m in _REACHES_M.items():
                share = surfaces.covered(apart, reach_m) if apart else None
                comparisons.compare(at, f"covered_{reach}", row[f"covered_{reach}"], share, tolerance=LENGTH_M)
            median = float(np.median(apart)) if apart else None
            comparisons.compare(at, "median_distance_m", row["median_distance_m"], median, tolerance=LENGTH_M)
            road = None
            if apart and cut["threshold_m"] is not None:
                heights = [float(p @ np.array(cut["axis"])) for p in own.points[members]]
                road = sum(h < cut["threshold_m"] for h in heights) / len(heights)
            comparisons.compare(at, "road_share", row["road_share"], road, tolerance=LENGTH_M)

        for community in pair.drawn_ids(side):
            compare(stored[side, community], own.members(community), f"{side} {community}")
        whole = stored[side, None]
        if pair.drawn.whole_sides:
            compare(whole, np.arange(len(own.points)), "")
        if (own.labels < 0).any():
            comparisons.leave_out("coverage of a whole side as the mean of its objects, where points belong to none")
            continue
        objects = [
            row for (own_side, i), row in stored.items() if own_side == side and i is not None and row["n_points"]
        ]
        for name in (*(f"covered_{reach}" for reach in COVERAGE_REACHES), "road_share"):
            values = [(row["n_points"], row[name]) for row in objects]
            known = (
                None if values[0][1] is None else math.fsum(n * own for n, own in values) / sum(n for n, _ in values)
            )
            comparisons.compare(pair.place("coverage", side), name, whole[name], known, tolerance=LENGTH_M)
        for reach in COVERAGE_REACHES:
            name = f"covered_{side}_{reach}"
            comparisons.compare(pair.place("pairs"), name, pair.row[name], whole[f"covered_{reach}"])


def check_surface(pair: StoredPair, comparisons: Comparisons) -> None:
    """How far the surfaces of the drawn real objects are displaced, and of whole sides also how rough they are."""
    rows = pair.rows("surface")
    stored = {row["real_id"]: row for row in rows}
    wanted = [*range(pair.n_objects("real")), None]
    comparisons.compare(pair.place("surface"), "real_id", [row["real_id"] for row in rows], wanted)
    points, labels = pair.sides["real"].points, pair.sides["real"].labels
    sample = _sample(points)
    sim = pair.sides["sim"].points

    def compare(row: Row, planes: list[surfaces.Plane], name: str) -> None:
        if any(plane.is_tied for plane in planes):
            comparisons.leave_out(
                "displacement of an object, some of whose points have equally near neighbours", ["surface"]
            )
            return
        made, at = surfaces.offset(planes, sim), pair.place("surface", object_=name)
        comparisons.compare(at, "n_points", row["n_points"], made.n_points)
        comparisons.compare(at, "n_directions", row["n_directions"], made.n_directions)
        for column, value in zip(SHIFT_COLUMNS, (*made.shift_m, made.distance_m), strict=True):
            comparisons.compare(at, column, row[column], value, tolerance=LENGTH_M * 10)

    for community in pair.drawn_ids("real"):
        own = [i for i in sample if labels[i] == community]
        compare(stored[community], [surfaces.local_plane(points, points[i]) for i in own], f"real {community}")
    for column in SHIFT_COLUMNS:
        comparisons.compare(pair.place("pairs"), column, pair.row[column], stored[None][column])
    if not pair.drawn.whole_sides:
        return
    planes = [surfaces.local_plane(points, points[i]) for i in sample]
    compare(stored[None], planes, "")
    of_sim = [surfaces.local_plane(sim, sim[i]) for i in _sample(sim)]
    if any(plane.is_tied for plane in (*planes, *of_sim)):
        what = "roughness of a pair, some of whose points have equally near neighbours"
        comparisons.leave_out(what, [f"pairs.roughness_{name}" for name in _ROUGHNESS])
        return
    roughness = [[plane.roughness_m for plane in own] for own in (planes, of_sim)]
    made: dict[str, float | None] = dict.fromkeys(_ROUGHNESS)
    if all(roughness):
        a, b = (np.array(own) for own in roughness)
        bias = float(b.mean() - a.mean())
        made = {"real_m": float(np.median(a)), "sim_m": float(np.median(b)), "bias_m": bias}
        made["area_m"] = surfaces.area_between(a.tolist(), (b - bias).tolist())
    for name, value in made.items():
        column = f"roughness_{name}"
        comparisons.compare(pair.place("pairs"), column, pair.row[column], value, tolerance=LENGTH_M)


def check_pieces(pair: StoredPair, comparisons: Comparisons) -> None:
    """Numbers, shares and moves of the stored pieces; of whole sides the pieces themselves."""
    own = pair.settings.pieces
    stored = {side: [row for row in pair.rows("pieces") if row["side"] == side] for side in SIDES}
    for side, other, word in (("real", "sim", "missing"), ("sim", "real", "invented")):
        n_points = sum(row["n_points"] for row in stored[side])
        made = {f"n_{word}_pieces": len(stored[side]), f"{word}_pieces_share": n_points / len(pair.sides[side].points)}
        for name, value in made.items():
            comparisons.compare(pair.place("pairs"), name, pair.row[name], value, tolerance=LENGTH_M)
        if not pair.drawn.whole_sides:
            comparisons.excuse(["pieces"])
            continue
        ground, place = pair.columns("ground", side), pair.place("pieces", side)
        points, others = pair.sides[side].all_points, pair.sides[other].all_points
        limits = (own.reach_m, own.link_m, own.min_points)
        found = pieces.pieces(points, ~pair.sides[side].is_object, ground["height_m"], others, *limits)
        rows: list[Row] = []
        for i, piece in enumerate(found):
            labels = [label for label in ground["label"][piece.members] if label is not None]
            label = min(set(labels), key=lambda word: (-labels.count(word), word)) if labels else None
            measures = (*piece.about.centroid, piece.about.range_m, *piece.about.extent)
            row = dict(zip(_DESCRIBED, measures, strict=False))
            about = {"bearing_deg": piece.bearing_deg, "height_m": piece.height_m, "label": label or ""}
            rows.append(row | about | {"side": side, "piece_id": i, "n_points": piece.about.n_points})
        for name in rows[0] if rows else ("piece_id",):
            values = [row[name] or "" if name == "label" else row[name] for row in stored[side]]
            comparisons.compare(place, name, values, [row[name] for row in rows], tolerance=LENGTH_M)
    places = {
        side: [([row[f"c{a}"] for a in "xyz"], [row[f"extent_{a}"] for a in "xyz"]) for row in rows]
        for side, rows in stored.items()
    }
    moved = pieces.moved(places["real"], places["sim"])
    for side, other, partners in (("real", "sim", moved), ("sim", "real", {j: i for i, j in moved.items()})):
        for i, row in enumerate(stored[side]):
            at, partner = pair.place("pieces", side, f"piece {i}"), partners.get(i)
            comparisons.compare(at, "fate", row["fate"], "gone" if partner is None else "moved")
            comparisons.compare(at, "partner_id", row["partner_id"], partner)
            for axis in range(3):
                ends = None if partner is None else [places[side][i][0][axis], places[other][partner][0][axis]]
                vector = ends and (ends[1] - ends[0]) * (1 if side == "real" else -1)
                name = f"moved_{'xyz'[axis]}_m"
                comparisons.compare(at, name, row[name], vector, tolerance=LENGTH_M)


def _sample(points: FloatArray) -> list[int]:
    """The points whose neighbourhoods are looked at."""
    return surfaces.visiting_order(points)[:_SAMPLE_POINTS] if len(points) >= _FEWEST_FOR_PLANES else []


def _is_ascending(src: IndexArray, dst: IndexArray, n: int) -> bool:
    """Whether each edge stands once, its smaller end first, in ascending order."""
    return bool((src < dst).all() and (np.diff(src * n + dst) > 0).all())


class _EdgeNames(Sequence[str]):
    """The names of edges, made when one is asked for: there are millions."""

    def __init__(self, src: IndexArray, dst: IndexArray) -> None:
        self._src, self._dst = src, dst

    def __len__(self) -> int:
        return len(self._src)

    def __getitem__(self, i: Any) -> Any:
        return f"point {self._src[i]} to {self._dst[i]}"
