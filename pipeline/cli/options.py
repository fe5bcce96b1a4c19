"""Options and arguments that several commands have, and the codes that they exit with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..engine.engine import Machines

#: Options of which each command says what they are, in its docstring.
Count = Annotated[int, typer.Option(min=1, metavar="N")]
Seed = Annotated[int, typer.Option(min=0, metavar="N")]
SettingsFile = Annotated[
    Path | None, typer.Option("--settings", metavar="FILE", help="TOML file of settings.")
]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="GROUP.NAME=VALUE", help="One setting; repeatable."),
]
Preset = Annotated[
    str | None,
    typer.Option(
        metavar="paper|reference",
        help="Objects of each side (paper), or of the real one (reference), to compare simulators.",
    ),
]
DatasetFolder = Annotated[
    Path, typer.Argument(help="Folder with real/ and sim/, or with pairs.csv.")
]
SimFolder = Annotated[
    Path | None,
    typer.Argument(
        metavar="SIM",
        help="Simulated scans, after the folder of the real ones; paired by name or by time.",
        show_default=False,
    ),
]
RunFolder = Annotated[
    Path,
    typer.Argument(help="Folder of a run, such as runs/dataset."),
]
Pairs = Annotated[
    str | None, typer.Option(metavar="PATTERN", help="Only these pairs, such as '00*'.")
]
Workers = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Processes, else one per core.")
]
LocalWorkers = Annotated[
    int,
    typer.Option(
        min=1, metavar="N", help="Processes on this machine; results do not depend on it."
    ),
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler to work on.")
]
PairTimeout = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", min=0.001, help="A pair that takes longer fails."),
]
BestCase = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN", help="Show scores minus those of this run of fidpipe best-case."
    ),
]
Replace = Annotated[bool, typer.Option(help="Replace finished results.")]
AsJson = Annotated[bool, typer.Option("--json", help="Strict JSON, nothing else.")]

EXIT_WRONG_INPUT = 1
EXIT_PAIRS_FAILED = 3
EXIT_GATE_FAILED = 4
EXIT_INTERRUPTED = 130


def machines_of(
    workers: int | None, scheduler: str | None = None, pair_timeout_s: float | None = None
) -> Machines:
    """Where a command works; `typer.BadParameter` if both machines and a cluster are given."""
    from ..engine.engine import Machines

    if scheduler is not None and workers is not None:
        raise typer.BadParameter(
            "--workers is for this machine, --scheduler for a cluster; give one of the two"
        )
    return Machines(workers, scheduler, pair_timeout_s)
