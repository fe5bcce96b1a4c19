"""What is asked of a run, and what has become of it.

Leaves to others: the run itself (`session`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from ...schemas.settings import Settings


@dataclass(frozen=True)
class RunRequest:
    """What the user asked for.

    dataset, out : folders
    workers : processes on this machine; None for one a core; 1 for none besides this one
    scheduler : address of a dask scheduler, instead of a cluster on this machine
    from_stage : this stage and those after it are made again
    pattern : only pairs whose name matches are worked on (shell style)
    """

    dataset: Path
    out: Path
    settings: Settings
    workers: int | None = None
    scheduler: str | None = None
    from_stage: str | None = None
    pattern: str | None = None


@dataclass(frozen=True)
class RunOutcome:
    """What has become of a run.

    pairs : the table `pairs`
    record : what `run.json` holds
    n_made, n_reused : jobs
    failed_extras : why a baseline or the like failed of a pair that is scored
    """

    folder: Path
    pairs: pa.Table
    record: dict[str, Any]
    n_made: int
    n_reused: int
    failed_extras: dict[str, str]

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of `pairs`."""
        rows: list[dict[str, Any]] = self.pairs.to_pylist()
        return rows

    @property
    def failures(self) -> dict[str, str]:
        """Why each failed pair failed, or what was asked for besides its scores."""
        failed = self.pairs.filter(pc.equal(self.pairs.column("status"), "failed")).select(["pair_id", "reason"])
        return {row["pair_id"]: row["reason"] for row in failed.to_pylist()} | self.failed_extras
