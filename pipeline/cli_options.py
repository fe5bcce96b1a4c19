"""Options and arguments that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SettingsFile = Annotated[
    Path | None, typer.Option("--settings", help="TOML file with settings; those it does not name keep their defaults.")
]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="GROUP.NAME=VALUE", help="One setting, such as graph.k=60; repeatable."),
]
DatasetFolder = Annotated[
    Path, typer.Argument(help="Folder with real/ and sim/, or with pairs.csv.", show_default=False)
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes on this machine; 1 starts no cluster. Default: one a core."),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", help="Address of a dask scheduler, such as tcp://host:8786, to work on."),
]
