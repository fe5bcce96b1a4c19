"""The jobs: each takes tables of a pair, calls one stage, and gives tables.

Leaves to others: which jobs there are (`run`), where tables come from and go (`workbench`), who calls them (`runner`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ...schemas.columns import SIDES
from ...schemas.metrics import OBJECT_METRICS
from ...schemas.tables import COMMUNITIES, GRAPH, GROUND, MATCHING, METRICS, OBJECTS, SELECTION
from ...stages.arrays import FloatArray
from ...stages.clean import clean_scan
from ...stages.communities import find_communities
from ...stages.graph import build_graph
from ...stages.ground import GroundResult, remove_ground
from ...stages.linalg.laplacian import Subgraph
from ...stages.matching import match_communities
from ...stages.metrics import score_object
from ...stages.objects import describe_objects, majority_labels
from ...stages.selection import Selection, select_nodes
from ...stages.summary import summarise_pair
from ..engine.task import Facts, Tables
from ..engine.workbench import Workbench, as_numpy


def make_ground(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """Clean points with ground flags."""
    task = bench.task
    with bench.step("read"):
        scan = bench.scan(side)
    is_sim = side == "sim"
    T = np.array(task.pair.T_real_sim).reshape(3, 4) if is_sim and task.pair.T_real_sim else None
    with bench.step("clean"):
        clean = clean_scan(
            scan.points, task.settings.input, flip_y=is_sim and task.settings.input.sim_flip_y, T_real_sim=T
        )
    shared = _cut_of(bench.facts("ground", "real")) if is_sim and task.settings.ground.shared else None
    with bench.step("ground"):
        cut = remove_ground(clean.points, task.settings.ground, shared)
    x, y, z = clean.points.T
    rows = GROUND.build(
        {
            "pair_id": bench.pair_id,
            "side": side,
            "point_id": clean.point_ids,
            "x": x,
            "y": y,
            "z": z,
            "height_m": cut.height_m,
            "is_ground": cut.is_ground,
            "intensity": None if scan.intensity is None else scan.intensity[clean.point_ids],
            "label": None if scan.labels is None else scan.labels[clean.point_ids].tolist(),
        },
        len(x),
    )
    n_ground = int(np.count_nonzero(cut.is_ground))
    facts: Facts = {
        "n_raw": len(scan.points),
        "n_clean": len(x),
        "n_points": len(x) - n_ground,
        "dropped": clean.dropped,
        "axis": cut.axis.tolist(),
        "peak_m": cut.peak_m,
        "threshold_m": cut.threshold_m,
        "loss": cut.loss,
        "iterations": cut.iterations,
        "removed_share": n_ground / len(x),
        "tilt_deg": cut.tilt_deg,
        "notes": list(cut.notes),
    }
    return {"ground": rows}, facts


def make_graph(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """Edges among object points."""
    point_ids, points = bench.object_points(side)
    with bench.step("graph"):
        edges = build_graph(points, bench.settings.graph)
    rows = GRAPH.build(
        {
            "pair_id": bench.pair_id,
            "side": side,
            "src": point_ids[edges.src],
            "dst": point_ids[edges.dst],
            "length_m": edges.length_m,
        },
        len(edges.src),
    )
    return {"graph": rows}, {"n_edges": len(edges.src)}


def make_communities(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """The objects of a side, and which point belongs to which."""
    point_ids, points = bench.object_points(side)
    edges = bench.edges(side, point_ids)
    with bench.step("louvain"):
        partition = find_communities(len(points), edges, bench.settings.communities)
    with bench.step("describe"):
        objects = describe_objects(points, partition.labels)
        ground = bench.table("ground", side)
        names = ground.filter(pc.invert(ground.column("is_ground"))).column("label").to_pylist()
        labels = majority_labels(partition.labels, names)
    of_both = {"pair_id": bench.pair_id, "side": side}
    communities = COMMUNITIES.build(of_both | {"point_id": point_ids, "community_id": partition.labels})
    columns = dict(zip(("cx", "cy", "cz"), objects.centroid.T, strict=True))
    columns |= dict(zip(("extent_x", "extent_y", "extent_z"), objects.extent.T, strict=True))
    columns |= dict(zip(("linearity", "planarity", "scattering"), objects.shape.T, strict=True))
    described = OBJECTS.build(
        of_both
        | columns
        | {
            "community_id": np.arange(len(objects.n_points), dtype=np.int32),
            "n_points": objects.n_points,
            "range_m": np.linalg.norm(objects.centroid, axis=1),
            "label": labels,
        }
    )
    facts = {"n_communities": len(objects.n_points), "modularity": partition.modularity}
    return {"communities": communities, "objects": described}, facts


def make_matching(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """Which objects both sides have, and which only one."""
    real, sim = (np.column_stack([as_numpy(bench.table("objects", of), c) for c in ("cx", "cy", "cz")]) for of in SIDES)
    with bench.step("match"):
        matching = match_communities(real, sim, bench.settings.matching)
    pairs = zip(matching.real_ids.tolist(), matching.sim_ids.tolist(), matching.distance_m.tolist(), strict=True)
    rows: list[Facts] = [
        {"real_id": a, "sim_id": b, "centroid_distance_m": d, "status": "matched"} for a, b, d in pairs
    ]
    rows += [{"real_id": a, "status": "missing"} for a in matching.missing.tolist()]
    rows += [{"sim_id": b, "status": "hallucinated"} for b in matching.hallucinated.tolist()]
    sizes = [as_numpy(bench.table("objects", of), "n_points") for of in SIDES]
    n_keep = np.minimum(sizes[0][matching.real_ids], sizes[1][matching.sim_ids])
    table = MATCHING.from_rows({"pair_id": bench.pair_id} | row for row in rows)
    return {"matching": table}, {"n_keep": list(zip(matching.real_ids.tolist(), n_keep.tolist(), strict=True))}


def make_selection(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """The aligned nodes of each matched object."""
    if bench.scores is not None:
        bench.add_steps(part.selection_steps for part in bench.scores)
        rows = pa.concat_tables([part.selection for part in bench.scores] or [SELECTION.from_rows([])])
        rows = rows.sort_by([(key, "ascending") for key in SELECTION.keys]).combine_chunks()
    else:
        rows = select_rows(bench)
    return {"selection": rows}, {}


def make_metrics(bench: Workbench, side: str) -> tuple[Tables, Facts]:
    """The scores of each matched object, and the row of the pair."""
    if bench.scores is not None:
        bench.add_steps(part.metrics_steps for part in bench.scores)
        rows = pa.concat_tables([part.metrics for part in bench.scores] or [METRICS.from_rows([])])
        rows = rows.sort_by([(key, "ascending") for key in METRICS.keys]).combine_chunks()
    else:
        rows = score_rows(bench, None, bench.table("selection"))
    return {"metrics": rows}, {"row": _pair_row(bench, rows)}


def select_rows(bench: Workbench, real_ids: Iterable[int] | None = None) -> pa.Table:
    """Rows of `selection`: of all matched objects, or of those with these real ids."""
    parts = [SELECTION.from_rows([])]
    for match in bench.matched(real_ids).to_pylist():
        real, sim = bench.subgraph("real", match["real_id"]), bench.subgraph("sim", match["sim_id"])
        chosen = select_nodes(real, sim, bench.settings.selection, watch=bench.watch)
        parts.append(
            SELECTION.build(
                {
                    "pair_id": bench.pair_id,
                    "real_id": match["real_id"],
                    "sim_id": match["sim_id"],
                    "rank": np.arange(len(chosen.real_nodes), dtype=np.int32),
                    "real_point_id": real.point_ids[chosen.real_nodes],
                    "sim_point_id": sim.point_ids[chosen.sim_nodes],
                    "real_influence": chosen.real_influence,
                    "sim_influence": chosen.sim_influence,
                },
                len(chosen.real_nodes),
            )
        )
    return pa.concat_tables(parts).combine_chunks()


def score_rows(bench: Workbench, real_ids: Iterable[int] | None, selection: pa.Table) -> pa.Table:
    """Rows of `metrics`: of all matched objects, or of those with these real ids."""
    rows = []
    for match in bench.matched(real_ids).to_pylist():
        real, sim = bench.subgraph("real", match["real_id"]), bench.subgraph("sim", match["sim_id"])
        chosen = chosen_nodes(selection, match["real_id"], real, sim)
        scores = score_object(real, sim, chosen, watch=bench.watch)
        sizes = {"n_real": len(real.points), "n_sim": len(sim.points), "n_keep": len(chosen.real_nodes)}
        del match["status"]
        rows.append(match | sizes | vars(scores))
    return METRICS.from_rows(rows)


def chosen_nodes(selection: pa.Table, real_id: int, real: Subgraph, sim: Subgraph) -> Selection:
    """The aligned nodes of one object, as the table `selection` has them."""
    start, end = np.searchsorted(as_numpy(selection, "real_id"), [real_id, real_id + 1])
    own = selection.slice(start, end - start)
    return Selection(
        real_nodes=np.searchsorted(real.point_ids, as_numpy(own, "real_point_id")),
        sim_nodes=np.searchsorted(sim.point_ids, as_numpy(own, "sim_point_id")),
        real_influence=as_numpy(own, "real_influence"),
        sim_influence=as_numpy(own, "sim_influence"),
    )


def _pair_row(bench: Workbench, metrics: pa.Table) -> Facts:
    """The row of `pairs` of a scored pair."""
    row: Facts = {"pair_id": bench.pair_id, "status": "scored"}
    for side in SIDES:
        facts = bench.facts("ground", side)
        row |= {f"n_{side}_{name}": facts[f"n_{name}"] for name in ("raw", "clean", "points")}
        for name in ("peak_m", "threshold_m", "loss", "iterations", "removed_share", "tilt_deg"):
            row[f"ground_{side}_{name}"] = facts[name]
        row[f"n_communities_{side}"] = bench.facts("communities", side)["n_communities"]
    ranges = {side: as_numpy(bench.table("objects", side), "range_m") for side in SIDES}
    status_of_match = bench.table("matching").column("status").to_pylist()
    ids = {side: bench.table("matching").column(f"{side}_id").to_pylist() for side in SIDES}

    def range_of(side: str, status: str) -> FloatArray:
        chosen = [i for i, found in zip(ids[side], status_of_match, strict=True) if found == status]
        found_m: FloatArray = ranges[side][np.array(chosen, dtype=np.intp)]
        return found_m

    return row | summarise_pair(
        {metric: metrics.column(metric).to_numpy() for metric in OBJECT_METRICS},
        metrics.column("status").to_pylist(),
        range_of("real", "matched"),
        range_of("real", "missing"),
        range_of("sim", "hallucinated"),
    )


def _cut_of(facts: Facts) -> GroundResult:
    """The real side's cut, for the simulated side to share."""
    return GroundResult(
        is_ground=np.empty(0, dtype=np.bool_),
        height_m=np.empty(0),
        axis=np.array(facts["axis"]),
        tilt_deg=facts["tilt_deg"],
        peak_m=facts["peak_m"],
        threshold_m=facts["threshold_m"],
        loss=facts["loss"],
        iterations=facts["iterations"],
    )
