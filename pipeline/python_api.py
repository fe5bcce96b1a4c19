"""The commands run, compare and diagnose for Python: the same results, whose tables are pandas frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..schemas.errors import RunError
from ..schemas.settings import Settings, parse
from .builds import dataset_and_run, runs_of
from .diagnose.diagnose import diagnose_run
from .engine.engine import Machines
from .engine.progress import Reporter
from .open_run import Run, open_run
from .results.compare import Comparison, compare_runs
from .run import run_dataset

#: Settings, such as {"graph.k": 60} or, by group, {"graph": {"k": 60}}.
SomeSettings = Settings | Mapping[str, Any]


def run(
    dataset: Path | str,
    sim: Path | str | None = None,
    *,
    out: Path | str | None = None,
    preset: str = "reference",
    settings: SomeSettings | None = None,
    workers: int | None = 1,
) -> Run:
    """Evaluate a dataset, or a folder of real and one of simulated scans; up-to-date results are reused.

    Failed pairs are rows of `pairs` with their reason.

    Parameters
    ----------
    dataset : folder with real/ and sim/ or with pairs.csv; with `sim`, folder of the real scans
    sim : folder of the simulated scans
    out : folder of the run; by default that of the command
    preset : "reference" to judge a simulator, "paper" to reproduce the paper
    settings : those that differ from the preset
    workers : processes; None for one per core, in a script guarded by `if __name__ == "__main__"`

    Raises
    ------
    FidpipeError
        The dataset or a setting is wrong, or the folder has finished results of other settings.
    """
    source, folder = dataset_and_run(
        Path(dataset), Path(sim) if sim else None, Path(out) if out else None
    )
    run_dataset(
        source, folder, _settings(preset, settings), Reporter(), machines=Machines(workers)
    )
    return open_run(folder)


def compare(
    *folders: Path | str | Run,
    preset: str = "reference",
    settings: SomeSettings | None = None,
    independent: bool = False,
    workers: int | None = 1,
) -> Comparison:
    """Compare two builds of a simulator on the same real scans: what got worse or better, and why.

    Parameters
    ----------
    folders : two runs, of which the first is the base; or two datasets, or the real scans and two simulated folders
    preset, settings, workers : for datasets and scans, see `run`
    independent : treat each pair as independent

    Raises
    ------
    FidpipeError
        A folder cannot be read or evaluated, or the runs cannot be compared.
    """
    paths = [folder.folder if isinstance(folder, Run) else Path(folder) for folder in folders]
    runs = runs_of(paths, _settings(preset, settings), Reporter(), Machines(workers))
    if len(runs) != 2:
        raise RunError(f"expected two runs to compare, got {len(runs)}")
    (comparison,) = compare_runs(runs, independent=independent)
    return comparison


def diagnose(run: Path | str | Run, *, workers: int | None = 1) -> Run:
    """Measure what fixing each cause of a run gains; `causes` of the run that is returned has them in this order.

    Parameters
    ----------
    run : a finished run
    workers : processes, see `run`

    Raises
    ------
    RunError
        The folder is not a finished run, or some pairs cannot be diagnosed.
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    diagnose_run(folder, Reporter(), Machines(workers))
    return open_run(folder)


def _settings(preset: str, settings: SomeSettings | None) -> Settings:
    if isinstance(settings, Settings):
        return settings
    groups: dict[str, Any] = {"preset": preset}
    for name, value in (settings or {}).items():
        group, _, field = name.partition(".")
        if field:
            groups[group] = {**groups.get(group, {}), field: value}
        else:
            groups[group] = value
    return parse(groups)
