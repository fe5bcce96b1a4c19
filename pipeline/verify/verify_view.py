"""The verification of a run: what was compared of each table, and each number that is wrong."""

from __future__ import annotations

from ...schemas.columns import SIDES
from ..report.view import Note, Table, View
from .verify import Mismatch, Verification

_UNKNOWN = "stages/literal does not have it, and it is not declared as not compared"


def verify_view(result: Verification) -> View:
    """One row a table, what could not be compared, each mismatch in a line of its own, and the verdict."""
    rows = [
        (table.table, f"{table.n_numbers:,}", f"{table.largest:.1e}" if table.largest else "0", table.where or "-")
        for table in result.tables
    ]
    drawn = f"{result.n_drawn:,} of {result.n_objects:,} objects of {result.n_pairs:,} of {result.n_scored:,} pairs"
    shown = len(result.mismatches)
    more = f" (the first {shown} of {result.n_wrong:,} are listed)" if result.n_wrong > shown else ""
    verdict = f"{result.n_wrong:,} of {result.n_numbers:,} numbers do not agree{more}"
    if result.passed:
        verdict = f"all {result.n_numbers:,} numbers agree"
    if result.unknown:
        verdict += f"; not verified: {len(result.unknown)} of their columns"
    columns = ("table", "numbers", "largest difference", "where")
    title = f"{result.run}: {drawn} computed again, seed {result.seed}"
    return [
        Table(title, columns, rows, words=(0, 3)),
        *(Note(f"not compared: {what}", "dim") for what in result.not_compared),
        *(Note(f"nothing recomputes: {name}: {_UNKNOWN}", "yellow") for name in result.unknown),
        *(Note(f"wrong: {_in_words(mismatch)}", "red") for mismatch in result.mismatches),
        Note(verdict, "green" if result.passed else "red"),
    ]


def _in_words(mismatch: Mismatch) -> str:
    is_object = mismatch.object.startswith(SIDES)
    places = (
        mismatch.table,
        f"pair {mismatch.pair_id}" if mismatch.pair_id else "",
        "" if is_object else mismatch.side,
        f"object {mismatch.object}" if is_object else mismatch.object,
        mismatch.column,
    )
    return f"{', '.join(filter(None, places))}: stored {mismatch.stored}, recomputed {mismatch.recomputed}"
