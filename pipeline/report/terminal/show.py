"""A pair or an object of a finished run in the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.columns import SIDES
from .layout import number, plain_table

_OBJECT_SCORES = (
    ("cdc", "CDC", "geometry: 0 the same points, 2 nothing near"),
    ("r_lambda", "r_lambda", "structure: max_eigenvalue_shift / laplacian_change; 0 best, 1 worst"),
    ("max_eigenvalue_shift", "max_eigenvalue_shift", "largest shift of an ordered eigenvalue"),
    ("laplacian_change", "laplacian_change", "spectral norm of the difference of the Laplacians"),
    ("r_gap", "r_gap", "|gap_sim - gap_real| / (2 laplacian_change); 0 best, 0.5 worst"),
    ("gap_real", "gap_real", "second smallest eigenvalue of the real object"),
    ("gap_sim", "gap_sim", "the same of the simulated object"),
    ("eigenspectrum_distance", "eigenspectrum_distance", "Euclidean distance of the ordered spectra"),
    ("alignment_rms_m", "alignment_rms_m", "distance of aligned nodes; large: r_lambda is to be mistrusted"),
    ("centroid_distance_m", "centroid_distance_m", "between the centroids"),
)
_PLACE = ("n_points", "range_m", "cx", "cy", "cz", "extent_x", "extent_y", "extent_z")
_SHAPE = ("linearity", "planarity", "scattering", "label")


def pair_view(found: Mapping[str, Any]) -> RenderableType:
    """The counts of a pair, its matched objects worst first, and those that only one side has."""
    row = found["pair"]
    if row["status"] != "scored":
        return Text.assemble(f"pair {row['pair_id']} ", ("failed", "red"), f": {row['reason']}")
    matched = [of for of in found["objects"] if of["status"] == "matched"]
    alone = [of for of in found["objects"] if of["status"] != "matched"]
    return Group(_pair_table(row), _matched_table(matched), _alone_table(alone))


def object_view(found: Mapping[str, Any]) -> RenderableType:
    """Place and shape of an object on both sides, then its scores."""
    title = f"Object of pair {found['pair_id']}: {found['status']}"
    table = plain_table(title, "", "real", "simulated")
    ids = [found[side] for side in SIDES]
    table.add_row("object", *("-" if of is None else str(of["community_id"]) for of in ids))
    for name in (*_PLACE, *_SHAPE):
        table.add_row(name, *(Text("-" if of is None else _shown(of[name])) for of in ids))
    scores = found["scores"]
    if scores is None:
        side = "real" if found["real"] else "simulated"
        return Group(table, Text(f"only the {side} side has this object, so that it has no scores"))
    of_scores = plain_table(f"Scores ({scores['status']}, on {scores['n_keep']} aligned nodes)", "score")
    of_scores.add_column("value", justify="right", no_wrap=True)
    of_scores.add_column("how to read it")
    for column, name, meaning in _OBJECT_SCORES:
        of_scores.add_row(name, number(scores[column], 4), meaning)
    reason = [Text(f"null scores: {scores['reason']}")] if scores["reason"] else []
    return Group(table, of_scores, *reason)


def _pair_table(row: Mapping[str, Any]) -> Table:
    table = plain_table(
        f"Pair {row['pair_id']}: match rate {number(row['match_rate'])}; {row['n_matched']} objects on both sides, "
        f"{row['n_missing']} missing, {row['n_hallucinated']} hallucinated",
        *("side", "points read", "clean", "not ground", "ground below, m", "objects"),
    )
    for side in SIDES:
        counts = (str(row[f"n_{side}_{name}"]) for name in ("raw", "clean", "points"))
        threshold = number(row[f"ground_{side}_threshold_m"], 2)
        table.add_row(side, *counts, threshold, str(row[f"n_communities_{side}"]))
    return table


def _matched_table(matched: list[dict[str, Any]]) -> Table:
    table = plain_table(
        "Objects that both sides have, largest r_lambda first",
        *(
            "class",
            "real",
            "sim",
            "range\nm",
            "points\nreal",
            "\nsim",
            "CDC",
            "r_lambda",
            "r_gap",
            "offset\nm",
            "align\nm",
        ),
    )
    for of in matched:
        real, scores = of["real"], of["scores"]
        table.add_row(
            Text(real["label"] or "-"),
            str(scores["real_id"]),
            str(scores["sim_id"]),
            number(real["range_m"], 1),
            str(scores["n_real"]),
            str(scores["n_sim"]),
            *(number(scores[name]) for name in ("cdc", "r_lambda", "r_gap")),
            *(number(scores[name], 2) for name in ("centroid_distance_m", "alignment_rms_m")),
        )
    return table


def _alone_table(alone: list[dict[str, Any]]) -> Table:
    table = plain_table(
        "Objects that only one side has",
        *("class", "status", "object", "range, m", "points", "height of centroid, m"),
        words=2,
    )
    for of in alone:
        side = "real" if of["real"] else "sim"
        own = of[side]
        table.add_row(
            Text(own["label"] or "-"),
            of["status"],
            f"{side}:{own['community_id']}",
            *(number(own["range_m"], 1), str(own["n_points"]), number(own["cz"], 1)),
        )
    return table


def _shown(value: Any) -> str:
    return number(value) if isinstance(value, float) else "-" if value is None else str(value)
