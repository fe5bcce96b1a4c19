"""Views of `fidpipe show`: a finished run, a pair, or an object of a pair."""

from __future__ import annotations

import shlex

from pydantic import JsonValue

from ....schemas.results import JsonObject
from ...results.finished import FinishedRun, object_facts, pair_facts, run_facts
from ...results.floor import RunExcess
from ...results.overview import over_floor
from ...storage.urls import url_or_path
from ..view import Note, Table, View
from .floor_view import pair_excess_table
from .pair_view import object_records, object_view, pair_records, pair_view
from .run_view import summary_view


def show_view(
    run: FinishedRun,
    pair: str | None,
    name: str | None,
    excess: RunExcess | None = None,
    *,
    with_all: bool = False,
) -> View:
    """A run, a pair of it, or the object `name` of a pair.

    Parameters
    ----------
    excess : of run or pair over a floor, to be shown as well
    with_all : all tables of the run, all objects of the pair
    """
    if pair is not None and name is not None:
        return object_view(pair, object_facts(run, pair, name))
    if pair is not None:
        notes = [Note(f"note: {note}", "yellow") for note in (run.record.notes or {}).get(pair, ())]
        command = "" if with_all else shlex.join(["fidpipe", "show", url_or_path(run.folder), pair, "--all"])
        return [
            *pair_view(pair_facts(run, pair), command),
            *notes,
            *([pair_excess_table(excess, pair)] if excess else ()),
        ]
    overview = run.overview if excess is None else over_floor(run, excess.floor)
    return summary_view(run.folder, run.rows, run.record, overview, excess=excess, with_all=with_all)


def show_json(run: FinishedRun, pair: str | None, name: str | None, excess: RunExcess | None = None) -> JsonValue:
    """The same as plain values."""
    over: JsonObject = {} if excess is None else {"excess": excess.as_dict()}
    if pair is not None and name is not None:
        return {"pair_id": pair, **object_facts(run, pair, name).as_dict()}
    return (run_facts(run) if pair is None else pair_facts(run, pair).as_dict()) | over


def show_records(run: FinishedRun, pair: str | None, name: str | None) -> Table:
    """The same for programs that read tables: one row per pair, object or value."""
    if pair is None:
        columns = list(run.rows[0])
        return Table("", columns, [[row[column] for column in columns] for row in run.rows])
    if name is None:
        return pair_records(pair_facts(run, pair))
    return object_records(object_facts(run, pair, name))
