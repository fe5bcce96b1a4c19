"""Shell completion: runs, their pairs and stages, presets, settings and measures.

Each answers at once: nothing but names is imported, and only the record of a run is read. If a
record cannot be read, the shell completes files.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import orjson
import typer

_RECORD = "run.json"
_LARGEST_RECORD = 50_000_000  # bytes: reading one takes a tenth of a second per 10 MB


def run_folders(incomplete: str) -> list[str]:
    """Folders of runs that begin with this text, up to two folders down."""
    above = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    try:
        runs = {
            str(path.parent) for below in ("*", "*/*") for path in above.glob(f"{below}/{_RECORD}")
        }
    except OSError:
        return []
    return _beginning(sorted(runs), incomplete)


def pairs(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of the pairs of the run that was typed before."""
    return _beginning(_recorded(ctx.params.get("run"), "inputs"), incomplete)


def stages(ctx: typer.Context, incomplete: str) -> list[str]:
    """Stages of the run that would be resumed: that of `--out`, or that of the dataset."""
    dataset = next(
        iter(ctx.args), None
    )  # an option without its value ends the parsing: arguments are not named yet
    folder = ctx.params.get("out") or (dataset and Path("runs") / Path(dataset).absolute().name)
    return _beginning(_recorded(folder, "stages"), incomplete)


def presets(incomplete: str) -> list[str]:
    """Names of the presets."""
    from ...schemas.settings import PRESETS

    return _beginning(PRESETS, incomplete)


def assignments(incomplete: str) -> list[str]:
    """The settings, as `--set` takes them: `graph.k=`."""
    from ...schemas.settings import Settings

    return _beginning(
        [f"{group}.{name}=" for group, values in Settings() for name, _ in values], incomplete
    )


def criteria(incomplete: str) -> list[str]:
    """The measures, as `--max` and `--min` take them: `r_lambda.mean=`."""
    from ..results.measure_names import PLAIN_NAMES

    return _beginning([f"{name}=" for name in PLAIN_NAMES], incomplete)


def _recorded(folder: Any, part: str) -> list[str]:
    """Names of the entries of one part of a run's record."""
    path = Path(folder or "") / _RECORD
    try:
        record = orjson.loads(path.read_bytes()) if path.stat().st_size < _LARGEST_RECORD else {}
    except (OSError, ValueError):
        return []
    names = record.get(part) if isinstance(record, dict) else None
    return list(names) if isinstance(names, dict) else []


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
