"""`fidpipe show --paper`: the paper's claims, checked on the objects of a finished run."""

from __future__ import annotations

from collections.abc import Sequence

from ...stages.paper.claim_rules import Claim
from ...stages.paper.run_claims import check_run_claims
from ..report.view import Note, Table, View, number
from ..results.finished import FinishedRun
from ..results.object_frame import STATISTICS_COLUMNS, arrays_of
from ..results.overview import independence


def claims_of(run: FinishedRun) -> list[Claim]:
    """The paper's claims with their verdicts; none if no pair is scored."""
    names = [row["pair_id"] for row in run.scored]
    if not names:
        return []
    objects = arrays_of(run.objects_of(names, STATISTICS_COLUMNS))
    contents, real_scans = ([run.record.inputs[name][key] for name in names] for key in ("content", "real"))
    return check_run_claims(*objects, contents, real_scans, [run.record.times_s.get(name) for name in names])


def claims_view(run: FinishedRun, claims: Sequence[Claim]) -> View:
    """The claims, one per row with its 95 % interval, then the rule of each."""
    undecided: dict[str, list[str]] = {}
    rows = []
    for i, claim in enumerate(claims, 1):
        if claim.why:
            undecided.setdefault(claim.why, []).append(str(i))
        interval = _interval(claim)
        rows.append((i, claim.claim, claim.paper, claim.here, interval, claim.n_pairs, claim.verdict))
    lines = [
        "Estimate and 95 % interval of the number in the rule, over independent pairs: how far it would move if",
        "other pairs had been recorded. Where it leaves both open, a claim is not decided; by chance under 5 % hold.",
        *independence(run.record.findings),
        *(f"not decided: {', '.join(numbers)}: {why}" for why, numbers in undecided.items()),
        "Rules:",
        *(f"{i:>3}  {claim.rule}" for i, claim in enumerate(claims, 1)),
    ]
    headings = ("", "claim", "paper", "here", "estimate and\n95 % interval", "pairs", "verdict")
    return [Table("The paper's claims", headings, rows, words=range(7), fixed=(4,)), *map(Note, lines)]


def _interval(claim: Claim) -> str:
    if claim.low is None or claim.high is None:
        return "-"
    digits = 3 if max(abs(claim.low), abs(claim.high)) < 10 else 1
    estimate, low, high = (number(value, digits) for value in (claim.estimate, claim.low, claim.high))
    return f"{estimate}\n{low} to {high}"
