"""Views of `fidpipe tasks`: agreement of a model's predictions on both sides, and odometry."""

from __future__ import annotations

from collections.abc import Sequence

from ...schemas.metric_catalogue import metric_of
from ...schemas.record import TaskSummary
from ..report.view import Note, Part, Table, View, columns_of, count, number, percent
from .predictions import Agreement

_MOST_PAIRS = 5


def agreement_view(result: Agreement) -> View:
    """Agreement by class, lost objects, and the scores that go with them."""
    n_lost = sum(row["fate"] == "lost" for row in result.objects)
    n_objects = len(result.objects)
    share = percent(n_lost / n_objects) if n_objects else "-"
    line = f"{count(n_objects, 'object')} with predictions, {n_lost} of them lost ({share})"
    parts: list[Part] = [Note(line, "bold"), _classes_table(result)]
    rows = []
    for score in result.scores:
        interval = f"{number(score.low)} to {number(score.high)}" if score.low is not None else "-"
        rows.append((metric_of(score.score).label, score.auc, interval))
    title = "Does a score go with a loss? (0.5: no; 1: lost objects have the larger scores)"
    parts.append(Table(title, ("score", "AUC", "95 %, leaving out scans"), rows, words=(0, 2)))
    if result.left_out:
        named = ", ".join(result.left_out[:_MOST_PAIRS])
        more = ", ..." if len(result.left_out) > _MOST_PAIRS else ""
        parts.append(Note(f"without predictions on both sides: {named}{more}", "yellow"))
    return parts


def object_records(result: Agreement) -> Table:
    """One row per object with a prediction, for programs."""
    columns = tuple(result.objects[0]) if result.objects else ()
    return Table("", columns, [tuple(row.values()) for row in result.objects])


def task_records(summaries: Sequence[TaskSummary]) -> Table:
    """One row per measure of a task, for programs."""
    columns = tuple(TaskSummary.model_fields)
    return Table("", columns, [[getattr(row, name) for name in columns] for row in summaries])


def odometry_view(summaries: Sequence[TaskSummary]) -> View:
    """Measures of odometry on both sides."""
    title = f"Odometry over {summaries[0].n_pairs} scans (KISS-ICP; gap 0: the same motion)"
    rows = []
    for row in summaries:
        sides = (number(row.real, 2), number(row.sim, 2))
        rows.append((row.measure, row.unit, *sides, number(row.gap, 3)))
    return [Table(title, ("measure", "unit", "real", "simulated", "gap"), rows, words=(0, 1))]


def _classes_table(result: Agreement) -> Table:
    if result.kind == "boxes":
        rows = []
        for row in result.classes:
            lost = percent(1 - row["n_found"] / row["n_real"]) if row["n_real"] else "-"
            added = percent(1 - row["n_found"] / row["n_sim"]) if row["n_sim"] else "-"
            counts = (row["n_real"], row["n_sim"])
            rows.append((row["class"], *counts, lost, added, number(row["place_m"], 2)))
        headings = ("class", "real", "simulated", "lost", "added", "place, m")
        title = "Boxes (the same within 2 m)"
        return Table(title, headings, rows)
    columns = ("class", "n_real", "n_sim", "iou")
    title = "Classes of the real points with a simulated one within 0.3 m"
    return Table(
        title,
        ("class", "real", "simulated", "IoU"),
        columns_of(result.classes, columns),
    )
