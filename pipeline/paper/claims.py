"""`fidpipe show --paper`: which of the paper's claims hold for the objects of a finished run."""

from __future__ import annotations

from collections.abc import Sequence

from ...stages.paper.claim_rules import Claim
from ...stages.paper.claims import check_claims
from ..report.view import Note, Table, View, number
from ..results.compare import recorded_times_s
from ..results.finished import FinishedRun
from ..results.objects import STATISTICS_COLUMNS, arrays_of
from ..results.overview import independence


def claims_of(run: FinishedRun) -> list[Claim]:
    """The paper's claims, each with its verdict; none if no pair is scored."""
    names = [row["pair_id"] for row in run.scored]
    if not names:
        return []
    objects = arrays_of([run.objects_of(names, STATISTICS_COLUMNS)])
    times_s = recorded_times_s(run)
    contents, real_scans = ([run.record.inputs[name][key] for name in names] for key in ("content", "real"))
    return check_claims(*objects, contents, real_scans, [times_s.get(name) for name in names])


def claims_view(run: FinishedRun, claims: Sequence[Claim]) -> View:
    """The claims, one per line with the 95 % interval, then the rule by which each is judged."""
    undecided: dict[str, list[str]] = {}
    for i, one in enumerate(claims, 1):
        if one.why:
            undecided.setdefault(one.why, []).append(str(i))
    lines = [
        "Estimate and interval are of what the rule names, over independent pairs: how far it would move if others had",
        "been recorded. Where that leaves both open a claim is not decided; by chance under one in twenty holds.",
        *independence(run.record.findings),
        *(f"not decided: {', '.join(numbers)}: {why}" for why, numbers in undecided.items()),
        "Rules:",
        *(f"{i:>3}  {one.rule}" for i, one in enumerate(claims, 1)),
    ]
    rows = [(i, one.claim, one.paper, one.here, *_interval_cells(one), one.verdict) for i, one in enumerate(claims, 1)]
    headings = ("", "claim", "paper", "here", "estimate and\n95 % interval", "pairs", "verdict")
    return [Table("The paper's claims", headings, rows, words=range(7), fixed=(4,)), *map(Note, lines)]


def _interval_cells(claim: Claim) -> tuple[str, int]:
    if claim.low is None or claim.high is None:
        return "-", claim.n_pairs
    digits = 3 if max(abs(claim.low), abs(claim.high)) < 10 else 1
    estimate, low, high = (number(value, digits) for value in (claim.estimate, claim.low, claim.high))
    return f"{estimate}\n{low} to {high}", claim.n_pairs
