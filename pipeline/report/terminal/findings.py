"""The findings of a run in the terminal: what the objects of all pairs say together, and the paper's claims."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ....stages.statistics.claim_rules import FAILS, HOLDS, UNKNOWN
from .layout import number, percent, plain_table

_MOST_CLASSES = 8
_COLOURS = {HOLDS: "green", FAILS: "red", UNKNOWN: "yellow"}


def findings_view(findings: Mapping[str, Any]) -> RenderableType:
    """Distributions, ranges, classes and four scans, as the paper's section "Real experiments" tells them."""
    parts: list[RenderableType] = [_distributions(findings), *_relations(findings), _bands(findings)]
    if findings["classes"]:
        parts.append(_classes(findings["classes"]))
    parts.append(_scans(findings["scans"]))
    return Group(*parts)


def claims_line(findings: Mapping[str, Any]) -> str:
    """How many of the paper's claims hold, in a line."""
    count = Counter(claim["verdict"] for claim in findings["claims"])
    return f"the paper's claims: {count[HOLDS]} hold here, {count[FAILS]} do not, {count[UNKNOWN]} cannot be checked"


def claims_view(claims: Sequence[Mapping[str, str]]) -> RenderableType:
    """The paper's claims, one a line, then the rule by which each is judged."""
    table = plain_table("The paper's claims", "", "claim", "paper", "here", "verdict", words=5)
    rules = [Text("By which rule:")]
    for i, claim in enumerate(claims, 1):
        verdict = Text(claim["verdict"], style=_COLOURS.get(claim["verdict"], ""))
        table.add_row(str(i), Text(claim["claim"]), Text(claim["paper"]), Text(claim["here"]), verdict)
        rules.append(Text(f"{i:>3}  {claim['rule']}"))
    return Group(table, *rules)


def _distributions(findings: Mapping[str, Any]) -> Table:
    columns = ("min", "q05", "q25", "median", "q75", "q95", "max", "std", "cv")
    table = plain_table(
        f"Objects (the {findings['n_matched']} that both sides have, of all pairs together)",
        "score",
        *("min", "5 %", "25 %", "median", "75 %", "95 %", "max", "std", "std/mean"),
    )
    for name, heading in (("cdc", "CDC"), ("r_lambda", "r_lambda"), ("r_gap", "r_gap")):
        table.add_row(heading, *(number(findings["distributions"][name][column]) for column in columns))
    return table


def _relations(findings: Mapping[str, Any]) -> list[Text]:
    rank, ratio = findings["rank_correlation"], findings["density_ratio"]
    return [
        Text(
            f"Rank correlation of CDC and r_lambda: Spearman {number(rank['spearman'], 2)}, "
            f"Kendall {number(rank['kendall'], 2)} (near 0: each tells what the other does not)"
        ),
        Text(
            f"Points, simulated / real: {number(ratio['min'], 2)} to {number(ratio['max'], 2)}, median "
            f"{number(ratio['median'], 2)}; below 1/4 in {percent(ratio['share_below_quarter'])}, "
            f"above 4 in {percent(ratio['share_above_four'])} of the objects\n"
        ),
    ]


def _bands(findings: Mapping[str, Any]) -> Table:
    found = findings["range_m"]
    table = plain_table(
        "By range (median range of matched objects "
        f"{number(found['median_matched'], 1)} m, of unmatched ones {number(found['median_unmatched'], 1)} m)",
        *("range, m", "real", "missing", "sim", "hallucinated"),
    )
    for band in found["bands"]:
        to = f"to {band['to_m']:.0f}" if band["to_m"] is not None else "and more"
        table.add_row(f"{band['from_m']:.0f} {to}", *_unmatched(band))
    return table


def _classes(classes: list[dict[str, Any]]) -> Table:
    title = "By class (of the real object where both sides have it)"
    if len(classes) > _MOST_CLASSES:
        title = f"The {_MOST_CLASSES} most frequent of {len(classes)} classes (of the real object where both have it)"
    table = plain_table(title, *("class", "real", "missing", "sim", "hallucinated", "both", "CDC", "r_lambda", "r_gap"))
    for row in classes[:_MOST_CLASSES]:
        scores = (number(row[f"{score}_mean"]) for score in ("cdc", "r_lambda", "r_gap"))
        table.add_row(Text(row["label"]), *_unmatched(row), str(row["n_matched"]), *scores)
    return table


def _scans(found: Mapping[str, Any]) -> Table:
    n = len(found["scans"])
    table = plain_table(
        f"{n} scans more than a minute apart (quartiles over their objects)"
        if found["apart"]
        else f"{n} scans evenly spaced by name (quartiles; no timestamps say that they are a minute apart)",
        *("pair", "time, s", "objects", "CDC 25 %", "50 %", "75 %", "r_lambda 25 %", "50 %", "75 %"),
    )
    for scan in found["scans"]:
        table.add_row(
            Text(scan["pair"]),
            number(scan["timestamp_s"], 0),
            str(scan["cdc"]["n"]),
            *(number(scan[score][q], 2) for score in ("cdc", "r_lambda") for q in ("q25", "median", "q75")),
        )
    return table


def _unmatched(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        str(row["n_real"]),
        f"{row['n_missing']} ({percent(row['missing_share'])})",
        str(row["n_sim"]),
        f"{row['n_hallucinated']} ({percent(row['hallucinated_share'])})",
    )
