"""Markdown of the contracts in `schemas`: tables, settings, sensors, baseline metrics, scores of matched objects."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from fidpipe.schemas.columns import Table
from fidpipe.schemas.metric_catalogue import METRIC, scores_of
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import PRESETS, Settings, parse
from fidpipe.schemas.settings_text import allowed
from fidpipe.schemas.tables import TABLES

_SHOWN = {"double": "float64", "float": "float32"}


def all_tables() -> str:
    """Markdown of all tables: a heading and the columns of each, except the pair and side that they begin with."""
    return "\n".join(
        f"### {table.name}\n\n{columns_of(table, table.of_file)}" for table in TABLES.values()
    )


def columns_of(table: Table, without: Sequence[str] = ()) -> str:
    """Markdown of a table: its sort keys; type, unit, nullability and meaning of its columns, equal ones in one row."""
    columns: dict[tuple[str, ...], list[str]] = {}
    for field in table.schema:
        if field.name in without:
            continue
        kind = _SHOWN.get(str(field.type), str(field.type))
        unit, meaning = (
            field.metadata.get(name, b"").decode() for name in (b"unit", b"meaning")
        )
        meaning = re.sub(
            r"^(mean|standard deviation \(n - 1\)) of \w+ over",
            r"\1 of the score over",
            meaning,
        )
        columns.setdefault((kind, unit, "yes" if field.nullable else "", meaning), []).append(
            f"`{field.name}`"
        )
    rows = [f"| {', '.join(names)} | {' | '.join(cells)} |" for cells, names in columns.items()]
    head = ["| column | type | unit | null | meaning |", "|---|---|---|---|---|"]
    return (
        "\n".join(
            [f"Sorted by {', '.join(f'`{key}`' for key in table.keys)}.", "", *head, *rows]
        )
        + "\n"
    )


def all_scores() -> str:
    """Markdown table of our own scores: name, column, range, direction, the paper's mean, and how to read it."""
    rows = [
        "| score | column | range | better | paper | meaning |",
        "|---|---|---|---|---|---|",
    ]
    for name in ("match_rate", *scores_of("object")):
        metric = METRIC[name]
        high = "" if metric.high is None else f" to {metric.high:g}"
        values = f"{metric.low:g}{high or ' or more'}" if metric.low is not None else "any"
        paper = (
            "" if metric.paper_mean is None else f"{metric.paper_mean:g} ± {metric.paper_std:g}"
        )
        cells = (
            metric.label,
            f"`{metric.column}`",
            values,
            metric.better or "",
            paper,
            metric.reading,
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def all_baselines() -> str:
    """Markdown table of the baseline metrics: name, columns, range, direction, and definition."""
    rows = ["| name | column | range | better | definition |", "|---|---|---|---|---|"]
    for name in scores_of("baseline"):
        metric = METRIC[name]
        bounds = (
            f"{metric.low:g} to {metric.high:g}"
            if metric.high is not None
            else f"{metric.low:g} or more"
        )
        meaning = metric.meaning + (f" ({metric.source})" if metric.source else "")
        rows.append(
            f"| `{metric.method}` | `{metric.column}` | {bounds} | {metric.better} | {meaning} |"
        )
    return "\n".join(rows) + "\n"


def all_sensors() -> str:
    """Markdown table of the known sensors: name, model, beams, elevations, and where these are published."""
    rows = [
        "| name | sensor | beams | degrees | elevations | source |",
        "|---|---|---|---|---|---|",
    ]
    for own in SENSORS.values():
        degrees = f"{min(own.elevation_deg):.4g} to {max(own.elevation_deg):.4g}"
        units = "differ per unit" if own.unit_deg else "as tabulated"
        rows.append(
            f"| `{own.name}` | {own.title} | {own.n_beams} | {degrees} | {units} | {own.source} |"
        )
    return "\n".join(rows) + "\n"


def all_settings() -> str:
    """All settings for people: a heading and a table for each group."""
    return "\n".join(f"## {group}\n\n{settings_of(group)}" for group in Settings.model_fields)


def settings_of(group: str) -> str:
    """A table of the settings of one group: name, value under each preset, allowed values, purpose.

    Parameters
    ----------
    group : such as "graph"; any other name raises `KeyError`
    """
    heads = ("setting", *PRESETS, "allowed", "what")
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    own: type[BaseModel] = type(Settings.model_fields[group].default)
    schema = own.model_json_schema()["properties"]
    presets = [getattr(parse(values), group) for values in PRESETS.values()]
    for name, field in own.model_fields.items():
        values = [_markdown(getattr(preset, name)) for preset in presets]
        cells = (f"`{group}.{name}`", *values, allowed(schema[name]), field.description)
        rows.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(rows) + "\n"


def _markdown(value: Any) -> str:
    if value is None or value == ():
        return "none"
    value = ",".join(value) if isinstance(value, tuple) else value
    return f"`{str(value).lower() if isinstance(value, bool) else f'{value:g}' if isinstance(value, float) else value}`"
