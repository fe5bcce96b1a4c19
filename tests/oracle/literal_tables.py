"""Tables of a pair, recomputed literally, each from the stored tables before it.

Where ties or rounding allow several correct answers, the stored one is accepted if it is one of
them. Not recomputed: descriptions of the sensors, incidence angles and rows of `rays`, scores under
other seeds, ground flags of patchwork++, objects by labels, ICP.
"""

import math

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

import literal_baselines
import literal_method
import literal_pieces
import literal_rays
import literal_surfaces
from fidpipe.schemas.columns import SIDES
from fidpipe.schemas.metric_catalogue import (
    COVERAGE_REACHES,
    OBJECT_METRICS,
    SHIFT_COLUMNS,
    scores_of,
)

#: Objects with more points are accepted as stored: dense matrices of all their nodes take minutes.
MOST_NODES = 3000
#: Heights this near to the threshold, and distances this near to delta, may be on either side.
ROUNDING_M = 1e-9
_REACHES_M = dict(zip(COVERAGE_REACHES, (0.1, 0.3, 1.0), strict=True))
_COVERED = tuple(f"covered_{reach}" for reach in COVERAGE_REACHES)
_OTHER = {"real": "sim", "sim": "real"}
_SAMPLED_PLANES = 2000
_FEWEST_FOR_PLANES = 20
_FEWEST_FOR_SPECTRA = 3
_ROUGHNESS = ("roughness_real_m", "roughness_sim_m", "roughness_bias_m", "roughness_area_m")


def clean(pair):
    """Points that cleaning keeps, one by one."""
    for side in SIDES:
        scan = pair.scan(side)
        transform = None
        if side == "sim" and pair.pair.T_real_sim:
            transform = np.array(pair.pair.T_real_sim).reshape(3, 4)
        frame = pair.settings.input.frame_of(side)
        settings = pair.settings.input.model_dump()
        kept, points = literal_method.clean(scan.points, settings, frame, transform)
        rows = {"point_id": kept, "x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
        rows["intensity"] = None if scan.intensity is None else scan.intensity[kept]
        rows["label"] = None if scan.labels is None else scan.labels[kept]
        rows["instance"] = None if scan.instances is None else scan.instances[kept]
        yield pair.rows("ground", rows, side)
        yield pair.summary({f"n_{side}_raw": len(scan.points), f"n_{side}_clean": len(kept)})


def ground(pair):
    """Heights and ground flags of all clean points, and the cut."""
    for side in SIDES:
        table = pair.table("ground", side)
        cut, heights, is_unique = _cut(pair, side)
        rows = {"point_id": table["point_id"], "height_m": heights - cut["peak_m"]}
        if pair.settings.ground.method != "patchwork":
            threshold_m = -math.inf if cut["threshold_m"] is None else cut["threshold_m"]
            is_tied = np.abs(heights - threshold_m) <= ROUNDING_M
            is_ground = (heights < threshold_m) | _on_real_road(
                pair, side, heights - cut["peak_m"]
            )
            rows["is_ground"] = np.where(is_tied, table["is_ground"], is_ground)
        yield pair.rows("ground", rows, side)
        n_ground = int(table["is_ground"].sum())
        names = ["peak_m", "threshold_m", "loss", "iterations"]
        if is_unique:
            names.append("tilt_deg")
        row = {f"ground_{side}_{name}": cut[name] for name in names}
        row[f"ground_{side}_removed_share"] = n_ground / len(table)
        row[f"n_{side}_points"] = len(table) - n_ground
        yield pair.summary(row)


def _cut(pair, side):
    """Cut of a side, heights of its points, and True if the points determine the axis."""
    settings = pair.settings.ground
    points = pair.sides[side].all_points
    stored_axis = np.array(pair.metadata("ground", side)["axis"])
    cut, heights, is_unique = literal_method.ground(points, settings.model_dump(), stored_axis)
    if side == "sim" and (settings.shared or settings.peak == "real"):
        real = pair.metadata("ground", "real")
        axis = np.array(real["axis"])
        offset_m = 0.0
        if not settings.shared:
            offset_m = literal_method.road_offset(pair.sides["real"].all_points, points, axis)
        if offset_m is not None:
            heights = np.array([float(point @ axis) for point in points])
            cut = {**real, "axis": axis, "peak_m": real["peak_m"] + offset_m}
            if real["threshold_m"] is not None:
                cut["threshold_m"] = real["threshold_m"] + offset_m
            limits_m = cut["threshold_m"] or 0.0, cut["peak_m"]
            cut["loss"] = literal_method.variance_loss(
                points, heights, *limits_m, settings.loss
            )
    if settings.method != "pca":
        cut |= {"threshold_m": None, "loss": None, "iterations": None}
    return cut, heights, is_unique


def _on_real_road(pair, side, heights_m):
    """True for the simulated points that lie on the real road, where the real side cuts both."""
    settings = pair.settings.ground
    real_points = pair.sides["real"].all_points
    points = pair.sides[side].all_points
    on_road = np.zeros(len(points), dtype=bool)
    real = pair.metadata("ground", "real")
    offset_m = None
    if side == "sim" and settings.peak == "real" and not settings.shared:
        offset_m = literal_method.road_offset(real_points, points, np.array(real["axis"]))
    table = pair.table("ground", "real")
    is_real_ground = table["is_ground"].to_numpy(dtype=bool)
    if offset_m is None or not is_real_ground.any():
        return on_road
    real_heights_m = table["height_m"].to_numpy()
    for i, point in enumerate(points):
        distances_m = literal_method.distances(real_points, point)
        if distances_m[~is_real_ground].min() <= 1.0:
            continue
        ground_m = np.where(is_real_ground, distances_m, np.inf)
        nearest = np.lexsort((*real_points.T[::-1], ground_m))[0]
        on_road[i] = (
            ground_m[nearest] <= 1.0
            and heights_m[i] - real_heights_m[nearest] <= settings.prior_m
        )
    return on_road


def graph(pair):
    """All edges, from all distances."""
    settings = pair.settings.graph
    for side, stored in pair.sides.items():
        points = stored.points
        rule = settings.edges
        edges = literal_method.edges(points, settings.k, settings.tau_m, rule, settings.ties)
        src, dst = np.array(edges, dtype=int).reshape(-1, 2).T
        length_m = literal_method.distances(points[dst], points[src]).astype(np.float32)
        rows = {
            "src": stored.point_ids[src],
            "dst": stored.point_ids[dst],
            "length_m": length_m,
        }
        yield pair.rows("graph", rows, side)


def communities(pair):
    """Object of every object point: by Louvain's method, or that of the nearest real point."""
    settings = pair.settings.communities
    for side, stored in pair.sides.items():
        if settings.objects == "reference" and side == "sim":
            labels = _labels_of_nearest(pair)
        else:
            labels = _labels_of_graph(pair, stored)
            is_louvain = settings.objects == "independent" or settings.reference == "louvain"
            if is_louvain and stored.edges[2].any():
                gain = literal_method.best_merge_gain(stored.labels, *stored.edges)
                name = "modularity gained by merging two communities"
                yield pair.values("communities", {name: max(0.0, gain)}, {name: 0.0})
        yield pair.rows(
            "communities", {"point_id": stored.point_ids, "community_id": labels}, side
        )


def _labels_of_graph(pair, stored):
    """Object of each point of a side that is partitioned on its own."""
    settings = pair.settings.communities
    is_reference = settings.objects == "reference"
    n_points = len(stored.points)
    src, dst, length_m = stored.edges
    order = range(n_points)
    visits = np.random.RandomState(settings.seed).permutation(n_points)
    if is_reference:
        order = literal_surfaces.visiting_order(stored.points, settings.seed)
        visits = np.array(order)
    if is_reference and settings.reference != "louvain":
        groups = stored.labels
    elif not length_m.any():
        linked = sparse.csr_array((np.ones(len(src)), (src, dst)), shape=(n_points, n_points))
        groups = connected_components(linked, directed=False)[1]
    elif settings.backend == "scikit-network":
        groups = literal_method.louvain(n_points, src, dst, length_m, visits)
    else:
        groups = stored.labels
    return literal_method.canonical(groups, order)


def _labels_of_nearest(pair):
    """Object of each simulated point: that of the nearest real one, or out of reach a new one."""
    settings = pair.settings.communities
    real = pair.sides["real"]
    sim = pair.sides["sim"]
    labels = sim.labels.copy()
    nearest_m = literal_method.nearest_distances(sim.points, real.points)
    for i, point in enumerate(sim.points):
        apart = literal_method.distances(real.points, point)
        tied = real.labels[apart <= nearest_m[i] * (1 + 1e-12)]
        if labels[i] not in tied:
            labels[i] = tied[0]
    outside = np.flatnonzero(nearest_m > settings.reach_m)
    components = literal_pieces.components(sim.points[outside], pair.settings.pieces.link_m)
    order = literal_surfaces.visiting_order(sim.points[outside], settings.seed)
    groups = np.array(literal_method.canonical(components, order), dtype=int)
    is_object = np.bincount(groups)[groups] >= settings.min_points
    labels[outside[is_object]] = real.labels.max() + 1 + groups[is_object]
    return labels


def objects(pair):
    """Size, place, shape and label of every object."""
    n_real = int(pair.sides["real"].labels.max()) + 1
    for side, stored in pair.sides.items():
        n_objects = int(stored.labels.max()) + 1
        if pair.settings.communities.objects == "reference":
            n_objects = max(n_objects, n_real)
        point_labels = pair.table("ground", side)["label"][stored.is_object]
        rows = []
        for community in range(n_objects):
            members = stored.members(community)
            row = dict.fromkeys((*literal_method.PLACE, *literal_method.SHAPE)) | {
                "n_points": 0
            }
            if len(members):
                row = literal_method.describe(stored.points[members])
            label = _most_frequent(point_labels.iloc[members])
            rows.append(row | {"community_id": community, "label": label})
        yield pair.rows("objects", rows, side)


def _most_frequent(labels):
    """Most frequent label, for equal counts the first in the alphabet; None if all are null."""
    counts = labels.value_counts().sort_index()
    return str(counts.idxmax()) if len(counts) else None


def matching(pair):
    """Matches of all objects."""
    settings = pair.settings.matching
    tables = [pair.table("objects", side) for side in SIDES]
    real, sim = [table[["cx", "cy", "cz"]].to_numpy() for table in tables]
    stored = {match["real_id"]: match["sim_id"] for match in pair.matches}
    n_fixed = 0
    if pair.settings.communities.objects == "reference":
        n_fixed = len(real)
        matched = _matches_of_reference(pair, *tables)
    elif settings.method == "greedy":
        triples = literal_method.match_greedy(real, sim, settings.delta_m, stored, ROUNDING_M)
        matched = {i: j for i, j, _ in triples}
    else:
        matched = stored
        yield _optimal_total(pair, real, sim)
    rows = []
    for i, j in matched.items():
        row = {"real_id": i, "sim_id": j, "status": "matched"}
        row["centroid_distance_m"] = math.dist(real[i], sim[j])
        rows.append(row)
    missing = [i for i in range(len(real)) if i not in matched]
    extra = [j for j in range(n_fixed, len(sim)) if j not in matched.values()]
    rows += [{"real_id": i, "sim_id": -1, "status": "not_found"} for i in missing]
    rows += [{"real_id": -1, "sim_id": j, "status": "extra"} for j in extra]
    yield pair.rows("matching", rows)


def _matches_of_reference(pair, real, sim):
    """Objects of the real side with enough simulated points."""
    fewest = np.minimum(pair.settings.communities.min_points, real["n_points"])
    is_matched = sim["n_points"][: len(real)] >= fewest
    return {i: i for i in np.flatnonzero(is_matched).tolist()}


def _optimal_total(pair, real, sim):
    """Mean cost of the stored matches and of an optimal matching; beyond delta it is a constant."""
    delta_m = pair.settings.matching.delta_m
    n_matches = min(len(real), len(sim))
    n = max(len(real), len(sim))
    forbidden = delta_m * (n_matches + 1)
    apart = cdist(real, sim)
    cost = np.zeros((n, n))
    cost[: len(real), : len(sim)] = np.where(apart < delta_m, apart, forbidden)
    total = (n_matches - len(pair.matches)) * forbidden
    for match in pair.matches:
        total += cost[match["real_id"], match["sim_id"]]
    name = "mean distance, m"
    return pair.values(
        "matching", {name: total / n}, {name: literal_method.least_total(cost) / n}
    )


def coverage(pair):
    """Coverage of each object and of each side."""
    rows = []
    for side, stored in pair.sides.items():
        other = _OTHER[side]
        cut = pair.metadata("ground", other)
        nearest_m = literal_method.nearest_distances(stored.points, pair.sides[other].points)
        n_objects = len(pair.table("objects", side))
        groups = {community: stored.members(community) for community in range(n_objects)}
        groups[-1] = np.arange(len(stored.points))
        for community, members in groups.items():
            row = _covered(nearest_m[members], stored.points[members], cut)
            rows.append(row | {"side": side, "community_id": community})
        whole = rows[-1]
        row = {f"covered_{side}_{reach}": whole[f"covered_{reach}"] for reach in _REACHES_M}
        yield pair.summary(row)
    yield pair.rows("coverage", rows)


def _covered(nearest_m, points, cut):
    """Covered shares of points, their median distance to the other side, share below its cut."""
    n = len(points)
    row = dict.fromkeys((*_COVERED, "median_distance_m", "road_share")) | {"n_points": n}
    if n == 0:
        return row
    for reach, reach_m in _REACHES_M.items():
        row[f"covered_{reach}"] = np.count_nonzero(nearest_m <= reach_m) / n
    row["median_distance_m"] = float(np.median(nearest_m))
    if cut["threshold_m"] is not None:
        heights = np.array([float(point @ np.array(cut["axis"])) for point in points])
        row["road_share"] = np.count_nonzero(heights < cut["threshold_m"]) / n
    return row


def surface(pair):
    """Displacement of the surface of each real object and of the whole; roughness of both sides."""
    planes = _planes(pair.sides["real"])
    sim_planes = _planes(pair.sides["sim"])
    stored = pair.table("surface").set_index("real_id").drop(columns="pair_id")
    labels = pair.sides["real"].labels
    n_objects = len(pair.table("objects", "real"))
    rows = []
    for real_id in [*range(n_objects), -1]:
        of_object = [plane for i, plane in planes.items() if real_id in (-1, labels[i])]
        if any(plane.is_tied for plane in of_object):
            row = stored.loc[real_id].to_dict()
        else:
            row = literal_surfaces.offset(of_object, pair.sides["sim"].points)
        rows.append(row | {"real_id": real_id})
    yield pair.rows("surface", rows)
    yield pair.summary({name: rows[-1][name] for name in SHIFT_COLUMNS})
    if not any(plane.is_tied for plane in (*planes.values(), *sim_planes.values())):
        yield pair.summary(_roughness(planes, sim_planes))


def _planes(stored):
    """Planes at sampled points of a side, by index of the point."""
    if len(stored.points) < _FEWEST_FOR_PLANES:
        return {}
    sample = literal_surfaces.visiting_order(stored.points)[:_SAMPLED_PLANES]
    return {i: literal_surfaces.local_plane(stored.points, stored.points[i]) for i in sample}


def _roughness(planes, sim_planes):
    """Columns of `pairs` about the roughness of both sides."""
    if not planes or not sim_planes:
        return dict.fromkeys(_ROUGHNESS)
    real = np.array([plane.roughness_m for plane in planes.values()])
    sim = np.array([plane.roughness_m for plane in sim_planes.values()])
    bias_m = float(sim.mean() - real.mean())
    return {
        "roughness_real_m": float(np.median(real)),
        "roughness_sim_m": float(np.median(sim)),
        "roughness_bias_m": bias_m,
        "roughness_area_m": literal_surfaces.area_between(
            real.tolist(), (sim - bias_m).tolist()
        ),
    }


def pieces(pair):
    """All pieces of both sides, and their fates."""
    rows = {}
    for side, stored in pair.sides.items():
        table = pair.table("ground", side)
        rows[side] = []
        for members, row in literal_pieces.pieces(
            stored.all_points,
            ~stored.is_object,
            table["height_m"].to_numpy(),
            pair.sides[_OTHER[side]].all_points,
            pair.settings.pieces.model_dump(),
        ):
            rows[side].append(row | {"label": _most_frequent(table["label"].iloc[members])})
        word = {"real": "missing", "sim": "invented"}[side]
        n_points = sum(row["n_points"] for row in rows[side])
        share = n_points / len(stored.points)
        yield pair.summary({f"n_{word}_pieces": len(rows[side]), f"{word}_pieces_share": share})
    fates = literal_pieces.fates(rows["real"], rows["sim"])
    described = [*rows["real"], *rows["sim"]]
    yield pair.rows("pieces", [row | fate for row, fate in zip(described, fates, strict=True)])


def rays(pair):
    """Partners and outcomes of the real returns; scores of all rays, groups and intensities."""
    stored = pair.table("rays")
    range_m = stored["real_range_m"].fillna(stored["sim_range_m"])
    yield pair.rows("ray_scores", _ray_scores(pair, stored, range_m))
    row = dict.fromkeys([*literal_rays.scores(_ray_columns(stored)), "intensity_note"])
    row |= dict.fromkeys(scores_of("intensity"))
    if len(stored):
        yield pair.rows("rays", _outcomes(pair, stored))
        row |= literal_rays.scores(_ray_columns(stored)) | _intensity_scores(pair, stored)
    yield pair.summary(row)


def _outcomes(pair, stored):
    """Partner of each real return, outcome of each ray; rays without real return are as stored."""
    sensors = [pair.metadata("sensor", side)["sensor"] for side in SIDES]
    noise_m = math.hypot(*(sensor["range_noise_m"] or 0.0 for sensor in sensors))
    points = [pair.sides[side].all_points for side in SIDES]
    real_ids, sim_ids = [pair.table("ground", side)["point_id"].to_numpy() for side in SIDES]
    index_of = {point_id: i for i, point_id in enumerate(real_ids)}
    partners = literal_rays.partners(*points, *sensors)
    rows = []
    for ray in stored.to_dict("records"):
        real_range_m = ray["real_range_m"]
        nearest_m = math.inf
        if not pd.isna(ray["real_point_id"]):
            i = index_of[ray["real_point_id"]]
            ray["sim_point_id"] = sim_ids[partners[i]] if i in partners else None
            real_range_m = math.hypot(*points[0][i])
            if i not in partners:
                nearest_m = literal_method.distances(points[1], points[0][i]).min()
        row = {name: ray[name] for name in ("beam", "column", "sim_point_id")}
        row["real_range_m"] = real_range_m
        row["outcome"] = literal_rays.outcome(
            real_range_m, ray["sim_range_m"], noise_m, nearest_m
        )
        rows.append(row)
    return rows


def _ray_scores(pair, stored, range_m):
    """Scores of each stored group of rays."""
    n_columns = stored.groupby("beam")["column"].max().min() + 1
    azimuth_deg = (stored["column"].clip(upper=n_columns - 1) + 0.5) * 360.0 / n_columns - 180.0
    values = {"range": range_m, "incidence": stored["incidence_deg"], "azimuth": azimuth_deg}
    rows = []
    for by, band in pair.table("ray_scores")[["by", "band"]].itertuples(index=False):
        group = stored
        if by in values:
            low, high = _limits(band)
            group = stored[(values[by] >= low) & (values[by] < high)]
        elif by == "class":
            group = stored[stored["label"] == band]
        row = {"by": by, "band": band} | literal_rays.scores(_ray_columns(group))
        if by not in ("all", "azimuth"):  # without a return: no range, incidence or class
            row["rays_drop_f1"] = None
        rows.append(row)
    return rows


def _limits(band):
    """Limits of a band such as "10 to 20 m" or "over 80 m"."""
    words = band.split()
    if words[0] == "over":
        return float(words[1]), math.inf
    return float(words[0]), float(words[2])


def _intensity_scores(pair, stored):
    """Scores of the intensities of all rays."""
    intensity = {}
    for side in SIDES:
        of_point = pair.table("ground", side).set_index("point_id")["intensity"].astype(float)
        intensity[side] = of_point.reindex(stored[f"{side}_point_id"]).to_numpy()
    is_same = pair.settings.input.intensity_scale == "same"
    return literal_rays.intensity_scores(_ray_columns(stored), intensity, has_one_scale=is_same)


def _ray_columns(stored):
    """Columns of rays as arrays, with None for no label."""
    columns = {name: stored[name].to_numpy() for name in stored}
    labels = stored["label"].astype(object)
    columns["label"] = labels.where(labels.notna(), None).to_numpy()
    return columns


def selection(pair):
    """Kept nodes of every object, their influence, and their alignment."""
    table = pair.table("selection")
    rows = []
    for match in pair.matches:
        stored = table[table["real_id"] == match["real_id"]].to_dict("records")
        members = pair.members(match)
        n_keep = min(map(len, members))
        if max(map(len, members)) > MOST_NODES or len(stored) != n_keep:
            rows += stored[:n_keep]
            continue
        ids = {"real_id": match["real_id"], "sim_id": match["sim_id"]}
        of_object = [ids | {"rank": rank} for rank in range(n_keep)]
        for side, indices in zip(SIDES, members, strict=True):
            kept = _selected(pair, pair.sides[side], indices, pd.DataFrame(stored))
            for row, (node, influence) in zip(of_object, kept, strict=True):
                row[f"{side}_point_id"] = pair.sides[side].point_ids[node]
                row[f"{side}_influence"] = influence
        rows += of_object
        yield _alignment_cost(pair, match)
    yield pair.rows("selection", rows)


def _alignment_cost(pair, match):
    """Mean distance of the aligned nodes of an object, stored and least possible."""
    real, sim = pair.points(pair.kept(match))
    cost = cdist(real - real.mean(axis=0), sim - sim.mean(axis=0))
    n = len(cost)
    name = "mean distance of aligned nodes, m"
    stored = math.fsum(np.diag(cost)) / n
    return pair.values(
        "selection", {name: stored}, {name: literal_method.least_total(cost) / n}
    )


def _selected(pair, stored_side, members, stored):
    """Kept nodes of a side of an object, by rank, and their influence.

    The stored nodes are accepted if no other node has more influence, up to rounding.
    """
    side = stored_side.side
    influence = literal_method.influence(
        stored_side.laplacian(members), pair.settings.selection.t
    )
    of_node = dict(zip(members.tolist(), influence.tolist(), strict=True))
    chosen = stored_side.index(stored[f"{side}_point_id"]).tolist()
    last = max(zip(-stored[f"{side}_influence"], chosen, strict=True))
    is_right = len(set(chosen)) == len(stored) and set(chosen) <= set(of_node)
    for node in set(of_node) - set(chosen):
        least = of_node[node] - 1e-11 * (1 + of_node[node])
        is_right = is_right and (-round(least, 9), node) > last
    if not is_right:
        chosen = sorted(of_node, key=lambda node: (-round(of_node[node], 9), node))[
            : len(stored)
        ]
    elif side == "real":
        order = sorted(zip(-stored["real_influence"], chosen, strict=True))
        chosen = [node for _, node in order]
    return [(node, of_node[node]) for node in chosen]


def metrics(pair):
    """Scores of every object, from the nodes that the selection kept."""
    table = pair.table("metrics").set_index("real_id")
    rows = []
    for match in pair.matches:
        members = pair.members(match)
        kept = pair.kept(match)
        n_keep = len(kept[0])
        row = {name: match[name] for name in ("real_id", "sim_id", "centroid_distance_m")}
        row |= {"n_real": len(members[0]), "n_sim": len(members[1]), "n_keep": n_keep}
        row["cdc"] = literal_method.cdc(*pair.points(members))
        row["alignment_rms_m"] = literal_method.alignment_rms(*pair.points(kept))
        if n_keep < _FEWEST_FOR_SPECTRA:
            row |= dict.fromkeys(literal_method.SPECTRAL) | {"status": "too_small"}
        elif n_keep > MOST_NODES:
            row |= table.loc[match["real_id"], [*literal_method.SPECTRAL, "status"]].to_dict()
        else:
            row |= literal_method.spectral(*pair.laplacians(kept))
            is_identical = row["laplacian_change"] <= literal_method.IDENTICAL_CHANGE
            row["status"] = "identical" if is_identical else "scored"
        rows.append(row)
    yield pair.rows("metrics", rows)


def baselines(pair):
    """Baseline metrics of every object and of the whole scans; others than these are as stored."""
    settings = pair.settings.metrics
    if not settings.baselines:
        return
    whole = [pair.sides[side].points for side in SIDES]
    values = {(-1, -1): literal_baselines.of_points(*whole, settings.model_dump())}
    for match in pair.matches:
        values[match["real_id"], match["sim_id"]] = _baselines_of_object(pair, match)
    rows = []
    table = pair.table("baselines")[["real_id", "sim_id", "baseline", "value"]]
    for row in table.to_dict("records"):
        of_object = values[row["real_id"], row["sim_id"]]
        rows.append(row | {"value": of_object.get(row["baseline"], row["value"])})
    yield pair.rows("baselines", rows)


def _baselines_of_object(pair, match):
    """Baseline metrics of a matched object by name."""
    settings = pair.settings.metrics.model_dump()
    members = pair.members(match)
    kept = pair.kept(match)
    real, sim = pair.points(members)
    real_kept, sim_kept = pair.points(kept)
    values = literal_baselines.of_points(real, sim, settings)
    centred = (real_kept - real_kept.mean(axis=0)) - (sim_kept - sim_kept.mean(axis=0))
    values["emd_centred_mean_m"] = float(np.linalg.norm(centred, axis=1).mean())
    if max(len(real), len(sim)) > MOST_NODES:
        return values
    values["emd_kept_mean_m"] = literal_baselines.assignment_mean(real_kept, sim_kept)
    if len(real) == len(sim) <= settings["emd_max_points"]:
        values["emd_mean_m"] = literal_baselines.assignment_mean(real, sim)
    return values


def pairs(pair):
    """Counts, match rate, means, deviations and medians over the objects of the pair."""
    fates = pair.table("matching")
    n_matched, n_not_found, n_extra = [
        int((fates["status"] == status).sum()) for status in ("matched", "not_found", "extra")
    ]
    row = {"status": "scored"}
    row["n_matched"] = n_matched
    row["n_not_found"] = n_not_found
    row["n_extra"] = n_extra
    row["n_communities_real"] = n_matched + n_not_found
    row["n_communities_sim"] = n_matched + n_extra
    row["match_rate"] = n_matched / (n_matched + max(n_not_found, n_extra))
    row["found"] = n_matched / (n_matched + n_not_found)
    scores = pair.table("metrics")
    for status in ("scored", "identical", "too_small"):
        row[f"n_{status}"] = int((scores["status"] == status).sum())
    for name in OBJECT_METRICS:
        row[f"{name}_mean"] = scores[name].astype(float).mean()
        row[f"{name}_std"] = scores[name].astype(float).std()
    real_m = pair.table("objects", "real")["range_m"]
    sim_m = pair.table("objects", "sim")["range_m"]
    matched_m = real_m[fates["real_id"][fates["status"] == "matched"]]
    missing_m = real_m[fates["real_id"][fates["status"] == "not_found"]]
    extra_m = sim_m[fates["sim_id"][fates["status"] == "extra"]]
    row["median_range_matched_m"] = matched_m.median()
    row["median_range_unmatched_m"] = pd.concat([missing_m, extra_m]).median()
    yield pair.summary(row)


#: Recomputation by stage, in the order of the method.
STAGES = (
    *(clean, ground, graph, communities, objects, matching, coverage, surface, pieces, rays),
    *(selection, metrics, baselines, pairs),
)
