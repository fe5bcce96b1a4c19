"""The record of a run: versions, settings, inputs, machine, and the duration of each step."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shlex
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
import pyarrow as pa

from ...schemas.metric_catalogue import DISTRIBUTED, METRIC, RUN_SCORES
from ...schemas.record import Machine, RunHeader, RunRecord
from ...schemas.results import ScoreSummary
from ...stages.summary import summarise_dataset, with_unmatched_as_worst
from .files import write_whole
from .table_files import TableFolder
from .urls import name_in_records, url_or_path

if TYPE_CHECKING:
    from ...schemas.settings import Settings

RUN_JSON = "run.json"
#: Records written by others have none.
_SEAL = re.compile(rb',\n  "sha256": "([0-9a-f]{64})"\n}\n\Z')
SETTINGS_TOML = "settings.toml"

#: Everything whose version can change a number or a file.
LIBRARIES = (
    "numpy",
    "scipy",
    "scikit-learn",
    "scikit-network",
    "python-louvain",
    "networkx",
    "POT",
    "pyarrow",
    "pandas",
    "dask",
    "distributed",
    "trimesh",
    "pypcd4",
)


def library_versions(names: Iterable[str]) -> dict[str, str]:
    """Installed versions by distribution name; "absent" of one that is not installed."""
    return {name: _version(name) for name in names}


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except (PackageNotFoundError, ValueError):
        return "absent"  # the caller says what to install


def read_run(folder: Path) -> dict[str, Any]:
    """The record of a run; {} if it does not exist yet or is damaged."""
    try:
        content = (folder / RUN_JSON).read_bytes()
        seal = _SEAL.search(content)
        if seal and hashlib.sha256(content[: seal.start()]).hexdigest() != seal[1].decode():
            return {}
        record: dict[str, Any] = orjson.loads(content)
        RunHeader.model_validate({name: record[name] for name in RunHeader.model_fields})
    except (FileNotFoundError, KeyError, TypeError, ValueError):
        return {}
    record.pop("sha256", None)
    return record


def write_record(tables: TableFolder, settings: Settings, record: Mapping[str, Any]) -> None:
    """Write `settings.toml` and `run.json`, whose last entry is the hash of the text before it."""
    from ...schemas.settings_text import to_toml  # not needed to read a record

    tables.check_token()
    write_whole(tables.folder / SETTINGS_TOML, to_toml(settings).encode())
    text = dumps(record).removesuffix(b"\n}\n")
    seal = f',\n  "sha256": "{hashlib.sha256(text).hexdigest()}"\n}}\n'
    write_whole(tables.folder / RUN_JSON, text + seal.encode())


def dumps(record: Mapping[str, Any]) -> bytes:
    """A record as JSON text."""
    return orjson.dumps(record, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def run_header(
    dataset: Path,
    settings: Settings,
    stages: Mapping[str, int],
) -> RunHeader:
    """Fields of `run.json` from the start of a run: inputs, settings and versions.

    Parameters
    ----------
    stages : code version by stage
    """
    from ...schemas.settings import overrides, preset_of  # not needed to read a record

    return RunHeader(
        fidpipe=_version("fidpipe"),
        written=datetime.now(UTC).isoformat(timespec="seconds"),
        dataset=name_in_records(dataset),
        preset=preset_of(settings),
        departures=tuple(overrides(settings)),
        settings=settings.model_dump(mode="json"),
        seed=settings.communities.seed,
        stages=dict(stages),
        libraries=dict(library_versions(LIBRARIES)),
        machine=Machine(
            python=platform.python_version(),
            system=platform.platform(),
            processor=platform.machine(),
            cores=os.cpu_count(),
        ),
    )


def last_results(before: Mapping[str, Any]) -> RunRecord | None:
    """The last record of a folder; None if its run has not ended, or the record is not one of a run."""
    try:
        return RunRecord.model_validate(before)
    except ValueError:
        return None


def summarise_pairs(scored: pa.Table) -> dict[str, ScoreSummary]:
    """Mean and standard deviation of each score over scored pairs; of bounded ones also with unmatched as worst.

    Parameters
    ----------
    scored : of `pairs`
    """
    scores: dict[str, Any] = {}
    for name in RUN_SCORES:
        scores[name] = np.array(scored[name].to_pylist(), dtype=np.float64)
    for name in DISTRIBUTED:
        scores[unmatched_worst(name)] = _with_unmatched(scored, name)
    return summarise_dataset(scores)


def unmatched_worst(metric: str) -> str:
    """The name in the summary of a score's mean with unmatched objects counted as worst."""
    return f"{metric}_unmatched_worst_mean"


def _with_unmatched(scored: pa.Table, name: str) -> list[float | None]:
    """Mean of an object score of each pair with objects that are not found or extra counted at its upper bound."""
    worst = METRIC[name].high
    if worst is None:
        raise ValueError(f"{name} has no upper bound that an unmatched object could count as")
    names = METRIC[name].mean_column, "n_matched", "n_too_small", "n_not_found", "n_extra"
    columns = [scored[name].to_pylist() for name in names]
    is_left_out = "required" not in METRIC[name].flags
    return [
        with_unmatched_as_worst(
            mean, n_matched - is_left_out * n_too_small, n_not_found + n_extra, worst
        )
        for mean, n_matched, n_too_small, n_not_found, n_extra in zip(*columns, strict=True)
    ]


def has_ended(record: Mapping[str, Any]) -> bool:
    """True if a record is of a finished run or experiment: its duration is written last."""
    return "wall_s" in record


def as_options(preset: str, departures: Iterable[str]) -> list[str]:
    """A preset and the settings that differ from it, as options of a command."""
    options = ["--preset", preset]
    for departure in departures:
        options += ["--set", departure]
    return options


def command_again(folder: Path, dataset: object) -> str:
    """Command that resumes a run with its settings."""
    path = folder / SETTINGS_TOML
    settings = ["--settings", str(path)] if path.exists() else []
    return shlex.join(["fidpipe", "run", str(dataset), "--out", url_or_path(folder), *settings])
