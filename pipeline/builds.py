"""Runs of what a user names: a folder of a dataset or of scans, or several builds of a simulator."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..schemas.settings import Settings
    from .engine.engine import Machines
    from .engine.progress import Reporter

#: Names of folders of scans that do not tell which build they are of.
_PLAIN_NAME = re.compile(
    r"(sim|scans?|lidar|velodyne|points?|clouds?|pcd|ply|bin|npy"
    r"|frames?|sweeps?|out|output|data|_|-)+",
    re.IGNORECASE,
)


def run_folder(dataset: Path) -> Path:
    """Default folder of the run of a dataset, or of a recording of the simulated side."""
    path = _normal(dataset)
    if path.name == "sim":
        path = path.parent
    return Path("runs") / (path.name or "dataset")


def side_run_folder(sim: Path) -> Path:
    """Default folder of the run of a simulated side: the last of its folders that has a name of its own.

    Examples
    --------
    >>> side_run_folder(Path("/data/build42/lidar_out")).as_posix()
    'runs/build42'
    """
    path = _normal(sim)
    named = [
        folder.name
        for folder in (path, *path.parents)
        if not _PLAIN_NAME.fullmatch(folder.name or "-")
    ]
    return Path("runs") / named[0] if named else run_folder(sim)


def side_run_folders(sims: Sequence[Path]) -> list[Path]:
    """Default folders of the runs of several simulated sides, named after the folders that tell them apart.

    Examples
    --------
    >>> names = side_run_folders([Path("/d/8/a/out"), Path("/d/8/b/out"), Path("/d/9/b/out")])
    >>> [folder.name for folder in names]
    ['8-a-out', '8-b-out', '9-b-out']
    """
    return _told_apart(sims, [side_run_folder(sim) for sim in sims])


def _told_apart(folders: Sequence[Path], runs: list[Path]) -> list[Path]:
    """The folders of the runs of some folders; other names if two of them have the same one."""
    paths = [_normal(folder) for folder in folders]
    if len(set(runs)) == len(set(paths)):
        return runs
    common = os.path.commonpath(paths)
    names = ["-".join(path.relative_to(common).parts) or path.name for path in paths]
    return [Path("runs") / name for name in names]


def _normal(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def dataset_and_run(dataset: Path, sim: Path | None, out: Path | None) -> tuple[Path, Path]:
    """Folders of a dataset and of its run.

    Parameters
    ----------
    dataset : folder of the dataset, or of its real side if `sim` is the simulated one
    out : folder of the run; None for the default
    """
    if sim is None:
        return dataset, out or run_folder(dataset)
    out = out or side_run_folder(sim)
    return _paired(dataset, sim, out), out


def _paired(real: Path, sim: Path, out: Path) -> Path:
    """Folder of the dataset of two sides; its manifest, if it needs one, is in `datasets` next to the run `out`."""
    from .datasets.pairing import dataset_of
    from .engine.progress import Reporter

    dataset, how = dataset_of(real, sim, out.parent / "datasets" / out.name)
    if how:
        Reporter().say(how)
    return dataset


def is_side(folder: Path) -> bool:
    """True if a folder holds the scans of one side (also one level down), or is a recording."""
    from .datasets.pairs import folders_of_scans
    from .datasets.readers.scan_ref import scan_ref

    if scan_ref(folder).format.holds_frames:
        return True
    if not folder.is_dir() or _has(folder, "run.json", "pairs.parquet", "real", "pairs.csv"):
        return False
    return bool(folders_of_scans(folder))


def runs_of(
    folders: Sequence[Path],
    settings: Settings,
    reporter: Reporter,
    machines: Machines | None = None,
) -> list[Path]:
    """Folders of runs. Datasets, or several simulated sides after a real one, are evaluated first.

    Parameters
    ----------
    folders : runs, datasets, or the real scans and the simulated ones of several builds
    settings : of what is evaluated

    Raises
    ------
    FidpipeError
        A folder does not exist, or cannot be evaluated.
    """
    from ..schemas.errors import RunError
    from .datasets.readers.scan_ref import scan_ref
    from .run import run_dataset
    from .storage.files import path_exists
    from .storage.urls import url_of_cache

    for folder in folders:
        if not (url_of_cache(folder) or path_exists(scan_ref(folder).file)):
            raise RunError(f"{folder}: no such file or folder; nothing was evaluated")
    if is_side(folders[0]):
        real, *sims = folders
        if len(sims) < 2:
            raise RunError(
                f"{real}: holds real scans; expected the simulated folders of two or more builds "
                "after it"
            )
        outs = side_run_folders(sims)
        datasets = [_paired(real, sim, out) for sim, out in zip(sims, outs, strict=True)]
    else:
        datasets = list(folders)
        unevaluated = [folder for folder in folders if not is_run(folder)]
        names = _told_apart(unevaluated, list(map(run_folder, unevaluated)))
        run_of = dict(zip(unevaluated, names, strict=True))
        outs = [run_of.get(folder, folder) for folder in folders]
    for folder, dataset, out in zip(folders[-len(outs) :], datasets, outs, strict=True):
        if dataset != out:
            reporter.say(f"{folder}: its run is {out}")
            run_dataset(dataset, out, settings, reporter, machines=machines)
    return outs


def is_run(folder: Path) -> bool:
    """True if a folder is to be read as a run: it has a record, or is not a dataset."""
    return _has(folder, "run.json") or not _has(folder, "real", "pairs.csv")


def _has(folder: Path, *names: str) -> bool:
    from .storage.files import path_exists

    return any(path_exists(folder / name) for name in names)
