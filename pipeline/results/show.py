"""What `fidpipe show` tells of a finished run, of a pair, or of an object: plain values, for the terminal and for JSON.

Leaves to others: reading (`finished`), showing (`report.show_view`).
"""

from __future__ import annotations

import re
from typing import Any

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from .finished import FinishedRun, PairObjects, Row


def run_facts(run: FinishedRun) -> dict[str, Any]:
    """The record and the rows of all pairs of a run."""
    return {"folder": str(run.folder), "record": run.record, "pairs": run.rows}


def pair_facts(run: FinishedRun, pair_id: str) -> dict[str, Any]:
    """The row of a pair and its objects: matched ones by r_lambda, worst first, then the others; none if it failed."""
    row = run.row(pair_id)
    if row["status"] != "scored":
        return {"pair": row, "objects": []}
    found = run.objects(pair_id)
    order = sorted(found.matched, key=lambda of: (of["r_lambda"] is None, -(of["r_lambda"] or 0.0), of["real_id"]))
    objects = [_matched(found, scores) for scores in order]
    objects += [_alone(found, "real", i) for i in found.missing]
    objects += [_alone(found, "sim", i) for i in found.hallucinated]
    return {"pair": row, "objects": objects}


def object_facts(run: FinishedRun, pair_id: str, name: str) -> dict[str, Any]:
    """One object of a pair: `7` or `real:7` is the real object 7 with its partner, `sim:7` the simulated one.

    Raises
    ------
    RunError
        The pair failed, or it has no such object.
    """
    side, _, number = name.rpartition(":")
    side = side or "real"
    found = run.objects(pair_id)
    if side not in SIDES or not re.fullmatch("[0-9]{1,9}", number) or int(number) >= len(found.sides[side]):
        counts = " and ".join(f"{len(found.sides[s])} {s}" for s in SIDES)
        raise RunError(
            f"run {run.folder}, pair {pair_id}: no object {name!r}; it has {counts} objects, numbered from 0: "
            "7 is a real object, sim:7 a simulated one"
        )
    i = int(number)
    scores = next((of for of in found.matched if of[f"{side}_id"] == i), None)
    return {"pair_id": pair_id} | (_alone(found, side, i) if scores is None else _matched(found, scores))


def _matched(found: PairObjects, scores: Row) -> dict[str, Any]:
    sides = {side: _own(found.sides[side][scores[f"{side}_id"]]) for side in SIDES}
    return {"status": "matched"} | sides | {"scores": _own(scores)}


def _alone(found: PairObjects, side: str, i: int) -> dict[str, Any]:
    own = _own(found.sides[side][i])
    status = "missing" if side == "real" else "hallucinated"
    return {"status": status, "real": None, "sim": None, "scores": None} | {side: own}


def _own(row: Row) -> Row:
    return {name: value for name, value in row.items() if name not in ("pair_id", "side")}
