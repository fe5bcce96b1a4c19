"""The findings of a run in the terminal: what the objects of all pairs say together, and the paper's claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....schemas.metrics import DISTRIBUTED, METRIC, labels
from ....schemas.results import Claim, ClassFindings, Findings, RangeFindings, Scans, Unmatched
from ....stages.statistics.claim_rules import FAILS, HOLDS, UNKNOWN
from .layout import number, percent, plain_table

_MOST_CLASSES = 8
#: The scores of the paper's box plots.
_BOXES = ("cdc", "r_lambda")
_COLOURS = {HOLDS: "green", FAILS: "red", UNKNOWN: "yellow"}


def findings_view(findings: Findings) -> RenderableType:
    """Distributions, ranges, classes and four scans, as the paper's section "Real experiments" tells them."""
    parts: list[RenderableType] = [_distributions(findings), *_relations(findings), _bands(findings.range_m)]
    if findings.classes:
        parts.append(_classes(findings.classes))
    parts.append(_scans(findings.scans))
    return Group(*parts)


def claims_line(findings: Findings) -> str:
    """How many of the paper's claims hold, in a line."""
    count = Counter(claim.verdict for claim in findings.claims)
    return f"the paper's claims: {count[HOLDS]} hold here, {count[FAILS]} do not, {count[UNKNOWN]} cannot be checked"


def claims_view(claims: Sequence[Claim]) -> RenderableType:
    """The paper's claims, one per line, then the rule by which each is judged."""
    table = plain_table("The paper's claims", "", "claim", "paper", "here", "verdict", words=5)
    rules = [Text("By which rule:")]
    for i, claim in enumerate(claims, 1):
        verdict = Text(claim.verdict, style=_COLOURS.get(claim.verdict, ""))
        table.add_row(str(i), Text(claim.claim), Text(claim.paper), Text(claim.here), verdict)
        rules.append(Text(f"{i:>3}  {claim.rule}"))
    return Group(table, *rules)


def _distributions(findings: Findings) -> Table:
    columns = ("min", "q05", "q25", "median", "q75", "q95", "max", "std", "cv")
    table = plain_table(
        f"Objects (the {findings.n_matched} that both sides have, of all pairs together)",
        "score",
        *("min", "5 %", "25 %", "median", "75 %", "95 %", "max", "std", "std/mean"),
    )
    for name in DISTRIBUTED:
        spread = getattr(findings.distributions, name)
        table.add_row(METRIC[name].label, *(number(getattr(spread, column)) for column in columns))
    return table


def _relations(findings: Findings) -> list[Text]:
    rank, ratio = findings.rank_correlation, findings.density_ratio
    return [
        Text(
            f"Rank correlation of CDC and r_lambda: Spearman {number(rank.spearman, 2)}, "
            f"Kendall {number(rank.kendall, 2)} (near 0: each tells what the other does not)"
        ),
        Text(
            f"Points, simulated / real: {number(ratio.min, 2)} to {number(ratio.max, 2)}, median "
            f"{number(ratio.median, 2)}; below 1/4 in {percent(ratio.share_below_quarter)}, "
            f"above 4 in {percent(ratio.share_above_four)} of the objects\n"
        ),
    ]


def _bands(found: RangeFindings) -> Table:
    table = plain_table(
        "By range (median range of matched objects "
        f"{number(found.median_matched, 1)} m, of unmatched ones {number(found.median_unmatched, 1)} m)",
        *("range (m)", "real", "missing", "sim", "hallucinated"),
    )
    for band in found.bands:
        to = f"to {band.to_m:.0f}" if band.to_m is not None else "and more"
        table.add_row(f"{band.from_m:.0f} {to}", *_unmatched(band))
    return table


def _classes(classes: Sequence[ClassFindings]) -> Table:
    title = "By class (of the real object where both sides have it)"
    if len(classes) > _MOST_CLASSES:
        title = f"The {_MOST_CLASSES} most frequent of {len(classes)} classes (of the real object where both have it)"
    table = plain_table(title, *("class", "real", "missing", "sim", "hallucinated", "both"), *labels(DISTRIBUTED))
    for row in classes[:_MOST_CLASSES]:
        scores = (number(row.of_score(score).mean) for score in DISTRIBUTED)
        table.add_row(Text(row.label), *_unmatched(row), str(row.n_matched), *scores)
    return table


def _scans(found: Scans) -> Table:
    n = len(found.scans)
    table = plain_table(
        f"{n} scans more than a minute apart (quartiles over their objects)"
        if found.apart
        else f"{n} scans evenly spaced by name (quartiles; no timestamps say that they are a minute apart)",
        *("pair", "time (s)", "objects"),
        *(text for name in _BOXES for text in (f"{METRIC[name].label} 25 %", "50 %", "75 %")),
    )
    for scan in found.scans:
        table.add_row(
            Text(scan.pair),
            number(scan.timestamp_s, 0),
            str(scan.cdc.n),
            *(number(getattr(getattr(scan, name), q), 2) for name in _BOXES for q in ("q25", "median", "q75")),
        )
    return table


def _unmatched(group: Unmatched) -> tuple[str, ...]:
    return (
        str(group.n_real),
        f"{group.n_missing} ({percent(group.missing_share)})",
        str(group.n_sim),
        f"{group.n_hallucinated} ({percent(group.hallucinated_share)})",
    )
