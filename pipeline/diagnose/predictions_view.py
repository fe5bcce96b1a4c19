"""Views of `fidpipe tasks`: agreement of a model's predictions on both sides, and odometry."""

from __future__ import annotations

from collections.abc import Sequence

from ...schemas.columns import Row
from ...schemas.metric_catalogue import metric_of
from ..report.view import Note, Part, Table, View, columns_of, count, number, percent
from .predictions import Agreement


def agreement_view(result: Agreement) -> View:
    """Agreement by class, lost objects, and the scores that go with them."""
    n_lost = sum(row["fate"] == "lost" for row in result.objects)
    n_objects = len(result.objects)
    share = percent(n_lost / n_objects) if n_objects else "-"
    line = f"{count(n_objects, 'object')} with predictions, {n_lost} of them lost ({share})"
    parts: list[Part] = [Note(line, "bold"), _classes_table(result)]
    rows = []
    for row in result.scores:
        interval = (
            "-" if row["low"] is None else f"{number(row['low'])} to {number(row['high'])}"
        )
        rows.append((metric_of(row["score"]).label, row["auc"], interval))
    title = "Does a score go with a loss? (0.5: no; 1: lost objects have the larger scores)"
    parts.append(Table(title, ("score", "AUC", "95 %, leaving out scans"), rows, words=(0, 2)))
    if result.left_out:
        n_left_out = count(len(result.left_out), "pair")
        parts.append(Note(f"{n_left_out} without predictions on both sides", "yellow"))
    return parts


def odometry_view(rows: Sequence[Row]) -> View:
    """Measures of odometry on both sides."""
    title = f"Odometry over {rows[0]['n_scans']} scans (KISS-ICP; gap 0: the same motion)"
    headings = ("measure", "unit", "real", "simulated", "gap")
    cells = columns_of(rows, ("measure", "unit", "real", "sim", "gap"))
    return [Table(title, headings, cells, words=(0, 1))]


def _classes_table(result: Agreement) -> Table:
    if result.kind == "labels":
        title = "Classes of the real points with a simulated one within 0.3 m"
        cells = columns_of(result.classes, ("class", "n_real", "n_sim", "iou"))
        return Table(title, ("class", "real", "simulated", "IoU"), cells)
    cells = []
    for row in result.classes:
        lost = percent(1 - row["n_found"] / row["n_real"]) if row["n_real"] else "-"
        added = percent(1 - row["n_found"] / row["n_sim"]) if row["n_sim"] else "-"
        place_m = number(row["place_m"], 2)
        cells.append([row["class"], row["n_real"], row["n_sim"], lost, added, place_m])
    headings = ("class", "real", "simulated", "lost", "added", "place, m")
    return Table("Boxes (the same within 2 m)", headings, cells)
