"""Finished runs that many tests share. Each is made once, by the worker that needs it first; no test writes to one.

A scenario is a folder with its dataset in `streets` and the run of it in `run`.
"""

import csv
import fcntl
import shutil
from pathlib import Path

import numpy as np

from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.generate.best_case_run import run_best_case
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.schemas.settings import Settings, load
from reports import HOSTILE_CLASS, HOSTILE_PAIRS
from runs import QUIET, run
from scenes import box, drifted, street, write_dataset, write_pair


def plain(folder, n_pairs=3, n=150):
    """Small streets under the default settings."""
    run(write_dataset(folder / "streets", n_pairs, n), folder / "run")


def labelled(folder):
    """Four small labelled pairs under the hostile names, and a fifth one that fails; with their report in `report`."""
    dataset = folder / "streets"
    rows = []
    for i, name in enumerate((*HOSTILE_PAIRS, "broken <b>pair</b>")):
        real = street(seed=10 * i)
        sim = drifted(real, seed=i, keep=0.9 - 0.1 * i)
        write_pair(dataset, real, sim, i, lambda points: np.where(points[:, 0] > 0, 1, 2))
        rows.append([name, f"real/{i}.bin", f"sim/{i}.bin"])
    (dataset / "sim" / "4.bin").write_bytes(b"")
    (dataset / "labels.toml").write_text(f"1 = '{HOSTILE_CLASS}'\n2 = 'wall'\n")
    with (dataset / "pairs.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["pair_id", "real", "sim"], *rows])
    run(dataset, folder / "run")
    write_report(folder / "run", out=folder / "report")


def reference(folder):
    """Two pairs under the preset `reference`; of a pole three points are simulated, and a box is invented."""
    for i in range(2):
        real = street(seed=10 * i)
        invented = box([14, 14, 1], [1, 1, 1], 40, i)
        write_pair(
            folder / "streets", real, np.vstack([drifted(real, seed=i), real[-3:], invented]), i
        )
    run(folder / "streets", folder / "run", load(None, ["graph.k=20"], preset="reference"))


def failed(folder):
    """Three pairs, the second one without a simulated point and the third one not requested."""
    data = write_dataset(folder / "streets", 3)
    (data / "sim" / "001.bin").write_bytes(b"")
    run(data, folder / "run", pattern="00[01]")


def extras(folder):
    """Two pairs with all baselines, further seeds and all tasks."""
    words = ["metrics.baselines=all", "stability.seeds=2", "tasks.names=all"]
    run(write_dataset(folder / "streets", 2), folder / "run", load(None, words))


def best_case(folder):
    """Three streets with their run, and their best case in `best_case`."""
    plain(folder)
    run_best_case(
        folder / "streets", folder / "best_case", Settings(), QUIET, machines=Machines(1)
    )


SCENARIOS = {
    make.__name__: make for make in (plain, labelled, reference, failed, extras, best_case)
}


class Shared:
    """Scenarios in a folder that all workers of a test session see."""

    def __init__(self, root):
        self._root = root

    def __call__(self, name, *sizes):
        """The folder of a scenario, which is made if no worker has made it; `sizes` as its function takes them."""
        folder = self._root / "-".join(map(str, ("scenario", name, *sizes)))
        with Path(f"{folder}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (folder / "whole").exists():
                shutil.rmtree(folder, ignore_errors=True)
                SCENARIOS[name](folder, *sizes)
                (folder / "whole").touch()
        return folder
