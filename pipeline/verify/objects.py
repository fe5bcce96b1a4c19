"""What the literal twin makes of a pair: its matches, their aligned nodes and scores, and its row of `pairs`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import BASELINES, METRIC, OBJECT_METRICS
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray
from ...stages.literal import baselines, method
from ..results.finished import FinishedRun
from .comparisons import INFLUENCE, LENGTH_M, ROUNDING, SPECTRUM, Comparisons, Place, point_names
from .stored import StoredPair, object_name

#: Larger objects are left out where dense matrices of all their nodes would be needed.
MOST_NODES = 3000
_FEWEST_FOR_SPECTRA = 3
#: Baselines that need the graphs or the aligned nodes of an object.
_OF_OBJECTS = ("emd", "netlsd", "r_h")
_ALONE = {"real": "missing", "sim": "hallucinated"}


def check_matching(pair: StoredPair, comparisons: Comparisons) -> None:
    """Which objects match, of all of them."""
    objects = {side: pair.columns("objects", side) for side in SIDES}
    real, sim = (np.column_stack([objects[side][axis] for axis in ("cx", "cy", "cz")]) for side in SIDES)
    place, settings, stored = pair.place("matching"), pair.settings.matching, pair.matching
    matched = [(row["real_id"], row["sim_id"]) for row in stored if row["status"] == "matched"]
    if pair.settings.communities.objects == "reference":
        n_real, n_sim = (objects[side]["n_points"] for side in SIDES)
        least = pair.settings.communities.min_points
        wanted = [(i, i) for i in range(len(real)) if n_sim[i] >= min(least, n_real[i])]
        hallucinated = list(range(len(real), len(sim)))
    elif settings.method == "greedy":
        found = method.match_greedy(real, sim, settings.delta_m, dict(matched), LENGTH_M)
        wanted = [(i, j) for i, j, _ in found]
        hallucinated = sorted(set(range(len(sim))) - {j for _, j in wanted})
    else:
        wanted = sorted(matched)
        hallucinated = sorted(set(range(len(sim))) - {j for _, j in wanted})
        _compare_optimum(real, sim, matched, settings.delta_m, place, comparisons)
    missing = sorted(set(range(len(real))) - {i for i, _ in wanted})
    of_real: list[tuple[int | None, int | None, str]] = [(i, j, "matched") for i, j in wanted]
    of_real = sorted([*of_real, *((i, None, "missing") for i in missing)], key=lambda row: row[0] or 0)
    made = [*of_real, *((None, j, "hallucinated") for j in hallucinated)]
    for name, own in zip(("real_id", "sim_id", "status"), zip(*made, strict=True), strict=True):
        comparisons.compare(place, name, [_or_blank(row[name]) for row in stored], [_or_blank(value) for value in own])
    for row in stored:
        both = row["status"] == "matched"
        apart = math.dist(real[row["real_id"]], sim[row["sim_id"]]) if both else None
        at = pair.place("matching", object_=object_name(row))
        comparisons.compare(at, "centroid_distance_m", row["centroid_distance_m"], apart, tolerance=LENGTH_M)


def _compare_optimum(
    real: FloatArray,
    sim: FloatArray,
    matched: list[tuple[int, int]],
    delta_m: float,
    place: Place,
    comparisons: Comparisons,
) -> None:
    """Whether no matching has more pairs nearer than delta, or a smaller total distance."""
    n, least = max(len(real), len(sim)), min(len(real), len(sim))
    apart, forbidden = cdist(real, sim), delta_m * (least + 1)
    cost = np.zeros((n, n))
    cost[: len(real), : len(sim)] = np.where(apart < delta_m, apart, forbidden)
    total = math.fsum(apart[i, j] for i, j in matched) + (least - len(matched)) * forbidden
    comparisons.compare(place, "total distance", total, method.least_total(cost), tolerance=LENGTH_M * n)
    within = [float(apart[i, j] < delta_m) for i, j in matched]
    comparisons.compare(place, "nearer than delta", within, [1.0] * len(matched))


def check_selection(pair: StoredPair, comparisons: Comparisons) -> None:
    """Which nodes of the drawn objects are kept, their influence, and that no alignment is shorter."""
    stored, matched = pair.columns("selection"), pair.matched
    sizes = [pair.n_kept(match) for match in matched]
    for side in SIDES:
        name = f"{side}_id"
        comparisons.compare(pair.place("selection"), name, stored[name], _each(matched, name, sizes))
    for match in pair.drawn_matches:
        own = stored["real_id"] == match["real_id"]
        at = pair.place("selection", object_=object_name(match))
        members = pair.members(match)
        n_keep = pair.n_kept(match)
        comparisons.compare(at, "rank", stored["rank"][own], np.arange(n_keep))
        if max(len(nodes) for nodes in members.values()) > MOST_NODES:
            comparisons.leave_out(
                f"influence and scores of an object of more than {MOST_NODES} points (dense matrices)",
                [f"selection.{side}_{what}" for side in SIDES for what in ("point_id", "influence")],
            )
            continue
        kept = {}
        for side in SIDES:
            scan, nodes = pair.sides[side], members[side]
            kept[side] = chosen = scan.index(stored[f"{side}_point_id"][own])
            values = stored[f"{side}_influence"][own]
            made = method.influence(method.laplacian(scan.matrix(nodes)), pair.settings.selection.t)
            of_point = dict(zip(nodes.tolist(), made.tolist(), strict=True))
            names, wanted = point_names(scan.point_ids[chosen]), [of_point.get(i) for i in chosen.tolist()]
            comparisons.compare(at, f"{side}_influence", values, wanted, tolerance=INFLUENCE, rows=names)
            covers = [f"selection.{side}_point_id"]
            comparisons.compare(at, f"different {side} nodes", len(set(chosen.tolist())), n_keep, covers=covers)
            last = max(zip((-values).tolist(), chosen.tolist(), strict=True))
            n_better = sum(
                (-round(of_point[i] * (1 - ROUNDING) - ROUNDING, 9), i) < last
                for i in set(nodes.tolist()) - set(chosen.tolist())
            )
            comparisons.compare(at, f"{side} nodes left out that have more influence", n_better, 0, covers=covers)
        real_influence, real_ids = stored["real_influence"][own], stored["real_point_id"][own]
        ranked = sorted(range(len(real_ids)), key=lambda i: (-real_influence[i], real_ids[i]))
        comparisons.compare(at, "order of rows", np.arange(len(ranked)), ranked)
        a, b = (pair.sides[side].points[kept[side]] for side in SIDES)
        cost = cdist(a - a.mean(axis=0), b - b.mean(axis=0))
        total = math.fsum(np.diag(cost))
        comparisons.compare(at, "total distance", total, method.least_total(cost), tolerance=LENGTH_M * len(cost))


def check_metrics(pair: StoredPair, comparisons: Comparisons) -> None:
    """The scores of the drawn objects, from the nodes that the selection kept."""
    rows, matched = pair.rows("metrics"), pair.matched
    stored = {row["real_id"]: row for row in rows}
    n_points = {side: pair.columns("objects", side)["n_points"] for side in SIDES}
    told: dict[str, list[Any]] = {
        name: [match[name] for match in matched] for name in ("real_id", "sim_id", "centroid_distance_m")
    }
    told |= {f"n_{side}": [n_points[side][match[f"{side}_id"]] for match in matched] for side in SIDES}
    told["n_keep"] = [pair.n_kept(match) for match in matched]
    names = [object_name(match) for match in matched]
    for name, own in told.items():
        same_rows = names if len(rows) == len(names) else None
        comparisons.compare(pair.place("metrics"), name, [row[name] for row in rows], own, rows=same_rows)
    for match in pair.drawn_matches:
        row, at = stored[match["real_id"]], pair.place("metrics", object_=object_name(match))
        real, sim = (pair.sides[side].points[pair.sides[side].members(match[f"{side}_id"])] for side in SIDES)
        kept = pair.kept(match)
        n_keep = len(kept["real"])
        comparisons.compare(at, "cdc", row["cdc"], method.cdc(real, sim), tolerance=LENGTH_M)
        rms = method.alignment_rms(*(pair.sides[side].points[kept[side]] for side in SIDES))
        comparisons.compare(at, "alignment_rms_m", row["alignment_rms_m"], rms, tolerance=LENGTH_M)
        if n_keep > MOST_NODES:
            comparisons.leave_out(
                f"spectra of an object of more than {MOST_NODES} aligned nodes (dense matrices)",
                [f"metrics.{name}" for name in (*method.SPECTRAL, "status", "reason")],
            )
            continue
        if n_keep < _FEWEST_FOR_SPECTRA:
            scores: dict[str, Any] = dict.fromkeys(method.SPECTRAL)
            status, reason = "too_small", f"{n_keep} aligned nodes, at least 3 are needed for a spectrum"
        else:
            L_real, L_sim = (method.laplacian(pair.sides[side].matrix(kept[side])) for side in SIDES)
            scores = method.spectral(L_real, L_sim)
            is_identical = scores["laplacian_change"] <= method.IDENTICAL_CHANGE
            status, reason = "identical" if is_identical else "scored", ""
        for name, value in scores.items():
            comparisons.compare(at, name, row[name], value, tolerance=SPECTRUM)
        comparisons.compare(at, "status", row["status"], status)
        comparisons.compare(at, "reason", row["reason"] or "", reason)


def check_baselines(pair: StoredPair, comparisons: Comparisons) -> None:
    """The distances of others, of the drawn objects, and of the whole scans where these are compared."""
    if not pair.settings.metrics.baselines:
        return
    stored = {(row["real_id"], row["baseline"]): row for row in pair.rows("baselines")}
    _compare_baseline_names(pair, comparisons)
    settings = pair.settings.metrics.model_dump()
    limits = {"netlsd": settings["heat_max_nodes"], "emd_mean_m": settings["emd_max_points"]}

    def compare(real_id: int | None, made: dict[str, float | None], name: str) -> None:
        for baseline, value in made.items():
            if (real_id, baseline) in stored:
                at = pair.place("baselines", object_=name)
                own = stored[real_id, baseline]["value"]
                comparisons.compare(at, baseline, own, value, tolerance=SPECTRUM, covers=["baselines.value"])
        for whose, baseline in stored:
            if whose == real_id and baseline not in made:
                comparisons.leave_out(f"baseline {baseline}, where the twin has none")

    for match in pair.drawn_matches:
        members = pair.members(match)
        real, sim = (pair.sides[side].points[members[side]] for side in SIDES)
        n_most, kept = max(len(real), len(sim)), pair.kept(match)
        a, b = (pair.sides[side].points[kept[side]] for side in SIDES)
        made: dict[str, float | None] = dict(baselines.of_points(real, sim, settings))
        made["emd_centred_mean_m"] = float(np.linalg.norm((a - a.mean(axis=0)) - (b - b.mean(axis=0)), axis=1).mean())
        if n_most <= MOST_NODES:
            made["emd_kept_mean_m"] = baselines.assignment_mean(a, b)
            if len(real) == len(sim) <= limits["emd_mean_m"]:
                made["emd_mean_m"] = baselines.assignment_mean(real, sim)
            A_real, A_sim = (pair.sides[side].matrix(members[side]) for side in SIDES)
            made["netlsd"] = baselines.netlsd(A_real, A_sim, settings) if n_most <= limits["netlsd"] else None
            made["r_h"] = None
            if len(a) >= _FEWEST_FOR_SPECTRA:
                L_real, L_sim = (method.laplacian(pair.sides[side].matrix(kept[side])) for side in SIDES)
                change = method.spectral(L_real, L_sim)["laplacian_change"]
                made["r_h"] = baselines.r_h(L_real, L_sim, pair.settings.selection.t, change)
        compare(match["real_id"], made, object_name(match))
    if pair.drawn.whole_sides:
        real, sim = (pair.sides[side].points for side in SIDES)
        compare(None, dict(baselines.of_points(real, sim, settings)), "")


def _compare_baseline_names(pair: StoredPair, comparisons: Comparisons) -> None:
    """Whether every object has a row of each distance, and the whole scans of those that need points alone."""
    wanted = [metric for metric in BASELINES if metric.method in pair.settings.metrics.baselines]
    made = [
        (str(row["real_id"]), str(row["sim_id"]), metric.column)
        for row in pair.matching
        if row["status"] == "matched"
        for metric in wanted
    ]
    made += [("None", "None", metric.column) for metric in wanted if metric.method not in _OF_OBJECTS]
    stored = [(str(row["real_id"]), str(row["sim_id"]), row["baseline"]) for row in pair.rows("baselines")]
    for name, kept, own in zip(
        ("real_id", "sim_id", "baseline"),
        zip(*sorted(stored), strict=True),
        zip(*sorted(made), strict=True),
        strict=True,
    ):
        comparisons.compare(pair.place("baselines"), name, kept, own)
    rows = pair.rows("baselines")
    units = [METRIC[row["baseline"]].unit or "" for row in rows]
    comparisons.compare(pair.place("baselines"), "unit", [row["unit"] or "" for row in rows], units)


def check_unmatched(run: FinishedRun, settings: Settings, place: Place, comparisons: Comparisons) -> None:
    """How many objects that one side alone has are there on the other, partly, or absent, and how many are road."""
    made = {alone: dict.fromkeys(("there", "partly", "absent", "road"), 0) for alone in _ALONE.values()}
    for own in run.scored:
        rows = run.read_table("coverage", own["pair_id"]).to_pylist()
        coverage = {(row["side"], row["community_id"]): row for row in rows}
        for match in run.read_table("matching", own["pair_id"]).to_pylist():
            for side, alone in _ALONE.items():
                if match["status"] == alone:
                    row = coverage[side, match[f"{side}_id"]]
                    share = row["covered_0p3m"]
                    made[alone]["there" if share > 0.8 else "partly" if share > 0.2 else "absent"] += 1
                    made[alone]["road"] += (row["road_share"] or 0) > 0.5
    for alone, counts in made.items():
        stored = getattr(run.record.metrics.unmatched, alone) if run.record.metrics else None
        for state, n in counts.items():
            if (kept := getattr(stored, state, None)) is not None:  # an older fidpipe did not count road
                comparisons.compare(place, f"metrics.unmatched.{alone}.{state}", kept, n)


def check_baseline_means(run: FinishedRun, settings: Settings, place: Place, comparisons: Comparisons) -> None:
    """Means and deviations over pairs of the distances of others, of objects and of whole scans."""
    of_pairs: dict[tuple[str, str], list[list[float | None]]] = {}
    for own in run.scored if settings.metrics.baselines else []:
        of_pair: dict[tuple[str, str], list[float | None]] = {}
        for row in run.read_table("baselines", own["pair_id"]).to_pylist():
            level = "scans" if row["real_id"] is None else "objects"
            of_pair.setdefault((row["baseline"], level), []).append(row["value"])
        for name, values in of_pair.items():
            of_pairs.setdefault(name, []).append(values)
    stored = {(summary.baseline, summary.level): summary for summary in run.record.baselines}
    comparisons.compare(place, "baselines", [*map(str, sorted(stored))], [*map(str, sorted(of_pairs))])
    for name, pairs in of_pairs.items():
        mean, std = method.mean_and_std([method.mean_and_std(values)[0] for values in pairs])
        n_null = sum(values.count(None) for values in pairs)
        made = {"mean": mean, "std": std, "n": sum(map(len, pairs)) - n_null, "n_null": n_null}
        for column, value in made.items():
            kept = getattr(stored[name], column)
            comparisons.compare(place, f"{name[0]}, {name[1]}, {column}", kept, value, tolerance=SPECTRUM)


def check_seeds(pair: StoredPair, comparisons: Comparisons) -> None:
    """The scores of the set seed are those of the pair; those of the others are not made again."""
    if pair.settings.stability.seeds == 1:
        return
    rows = pair.rows("seeds")
    first = pair.settings.communities.seed
    wanted = range(first, first + pair.settings.stability.seeds)
    comparisons.compare(pair.place("seeds"), "seed", [row["seed"] for row in rows], list(wanted))
    for name, value in rows[0].items():
        if name not in ("pair_id", "seed"):
            comparisons.compare(pair.place("seeds"), name, value, pair.row[name])
    comparisons.leave_out("scores under other seeds of the communities")


def check_pairs(pair: StoredPair, comparisons: Comparisons) -> None:
    """The pair's row: counts, match rate, means, deviations and medians over its objects."""
    place, row = pair.place("pairs"), pair.row
    statuses = [own["status"] for own in pair.matching]
    metrics = pair.rows("metrics")
    n = {name: statuses.count(name) for name in ("matched", "missing", "hallucinated")}
    made: dict[str, Any] = {f"n_{name}": count for name, count in n.items()}
    kinds = [own["status"] for own in metrics]
    made |= {f"n_{kind}": kinds.count(kind) for kind in ("scored", "identical", "too_small")}
    made |= {f"n_communities_{side}": n["matched"] + n[alone] for side, alone in _ALONE.items()}
    made["match_rate"] = n["matched"] / (n["matched"] + max(n["missing"], n["hallucinated"]))
    made["found"] = n["matched"] / (n["matched"] + n["missing"])
    ranges = {side: pair.columns("objects", side)["range_m"] for side in SIDES}
    matched, alone = [], []
    for own in pair.matching:
        if own["status"] == "matched":
            matched.append(float(ranges["real"][own["real_id"]]))
        else:
            side = "real" if own["status"] == "missing" else "sim"
            alone.append(float(ranges[side][own[f"{side}_id"]]))
    made["median_range_matched_m"] = float(np.median(matched)) if matched else None
    made["median_range_unmatched_m"] = float(np.median(alone)) if alone else None
    for metric in OBJECT_METRICS:
        mean, std = method.mean_and_std([own[metric] for own in metrics])
        made |= {f"{metric}_mean": mean, f"{metric}_std": std}
    made |= {"pair_id": pair.pair_id, "status": "scored"}
    comparisons.compare(place, "no reason", row["reason"] or "", "")
    for name, value in made.items():
        tolerance = 0.0 if name.startswith("n_") else LENGTH_M
        comparisons.compare(place, name, row[name], value, tolerance=tolerance)


def _each(matches: list[Row], name: str, sizes: list[int]) -> list[int]:
    """The ids of some matches, each as often as the match has aligned nodes."""
    return [match[name] for match, n in zip(matches, sizes, strict=True) for _ in range(n)]


def _or_blank(value: int | str | None) -> str:
    """An id or a word as a word."""
    return "" if value is None else str(value)
