"""View of the verification of a run: compared values of each table, and each wrong number."""

from __future__ import annotations

from ...schemas.columns import SIDES
from ..report.view import Note, Table, View
from .compare_frames import Mismatch
from .verify import Verification

_UNKNOWN = "it is missing in stages/literal, and not declared as not compared"


def verify_view(result: Verification) -> View:
    """View of a verification: one row per table, values not compared, one line per mismatch, and the verdict."""
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
    title = f"{result.run}: {drawn} recomputed, seed {result.seed}"
    return [
        Table(title, columns, rows, words=(0, 3)),
        *(Note(f"not compared: {what}", "dim") for what in result.not_compared),
        *(Note(f"not recomputed: {name}: {_UNKNOWN}", "yellow") for name in result.unknown),
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
