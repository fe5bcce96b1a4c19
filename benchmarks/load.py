"""Does a large run hold out: are all pairs scored or named, does the memory stay flat, is the folder consistent?

    python benchmarks/load.py [N_PAIRS] [POINTS] [SECONDS_BETWEEN_KILLS] [FIGURE]   by default 5000 pairs of 300 points
    python benchmarks/load.py draw FIGURE   again, from the samples that lie beside it as .csv

One pair in a hundred is poison: a file that is cut off, one of three points, one whose reader (of another package)
crashes the interpreter while files are read, or in a stage. While the command works on four workers of this machine,
one of them is killed every minute, and the memory of all processes is noted every two seconds. Pairs repeat some
hundred scenes, so that every row can be compared with that of its first like. Then `status`, and a second run, which
has only the poison to do.
"""

import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import psutil
from measure import FIDPIPE, MIB, machine, repeated, scratch, weigh

N_FILES = 180
WORKERS = 4
ONE_IN = 100
SECONDS_BETWEEN_SAMPLES = 2.0

#: Whose resident memory is sampled, by column.
NAMES = {
    "command_mib": "command, with dask's scheduler",
    "worker_mib": "largest worker",
    "all_mib": "all processes",
}

READER = """
import ctypes

from fidpipe.pipeline.datasets.readers import float32


def read(path):
    with path.with_suffix(".readings").open("a+") as readings:
        readings.write("x")
        readings.flush()
        readings.seek(0)
        if len(readings.read()) >= int(path.stem.rpartition("-")[2]):
            ctypes.string_at(0)
    return float32.read(path, ("x", "y", "z", "intensity"))
"""


def install_reader(folder):
    """A package with a reader of `.trap`, which crashes at the reading that the file's name ends with."""
    about = folder / "fidpipe_trap-1.0.dist-info"
    about.mkdir(parents=True, exist_ok=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: fidpipe-trap\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[fidpipe.readers]\ntrap = fidpipe_trap\n")
    (folder / "fidpipe_trap.py").write_text(READER)


def poison(listed):
    """Makes one pair in a hundred unusable; gives by pair what was done to it."""
    rows = pd.read_csv(listed / "pairs.csv", dtype=str)
    kinds = ("cut off", "three points", "crash while files are read", "crash in a stage")
    done = {}
    for i, row in enumerate(range(ONE_IN // 2, len(rows), ONE_IN)):
        pair_id = rows.pair_id[row]
        kind = kinds[i % len(kinds)]
        content = Path(rows.real[row]).read_bytes()
        crashes_at = {kinds[2]: "-1.trap", kinds[3]: "-2.trap"}.get(kind, ".bin")
        path = listed / f"poison-{pair_id}{crashes_at}"
        path.write_bytes({kinds[0]: content[:-5], kinds[1]: content[:48]}.get(kind, content))
        rows.loc[row, "real"] = str(path)
        done[pair_id] = kind
    rows.to_csv(listed / "pairs.csv", index=False)
    return done


class Harmed:
    """The command while workers of it are killed and its memory is noted.

    samples : a row each two seconds, of seconds since the start, and MiB; see `NAMES`
    """

    def __init__(self, words, seconds_between_kills, errors, environment):
        self._samples = []
        self.n_killed = 0
        self._rng = random.Random(0)
        self._every_s = seconds_between_kills
        with errors.open("w") as file:
            self.process = subprocess.Popen(
                [FIDPIPE, *map(str, words)],
                stdout=subprocess.DEVNULL,
                stderr=file,
                env=environment,
            )
            self.begun = time.time()
            self._begun = time.monotonic()
            watcher = threading.Thread(target=self._watch)
            watcher.start()
            self.code = self.process.wait()
        self.wall_s = time.monotonic() - self._begun
        watcher.join()
        self.samples = pd.DataFrame(self._samples, columns=["seconds", *NAMES]).round(1)

    def _watch(self):
        next_kill = self._begun + self._every_s
        while self.process.poll() is None:
            workers = self._sample()
            if time.monotonic() > next_kill and workers:
                self._rng.choice(workers).kill()
                self.n_killed += 1
                next_kill += self._every_s
            time.sleep(SECONDS_BETWEEN_SAMPLES)

    def _sample(self):
        try:
            command = psutil.Process(self.process.pid)
            family = command.children(recursive=True)
            workers = [member for member in family if member.ppid() != command.pid]
            sizes = {
                member.pid: member.memory_info().rss / MIB for member in (command, *family)
            }
        except psutil.NoSuchProcess:
            return []
        if not sizes[command.pid]:  # it has ended
            return []
        of_workers = [sizes[member.pid] for member in workers]
        seconds = time.monotonic() - self._begun
        self._samples.append(
            (seconds, sizes[command.pid], max(of_workers, default=np.nan), sum(sizes.values()))
        )
        return workers


def judge(out, listed, poisoned):
    """What became of the pairs: counts, reasons, and how many rows are not those of their first like."""
    pairs = pd.read_parquet(out / "pairs.parquet").set_index("pair_id")
    rows = pd.read_csv(listed / "pairs.csv", dtype=str).set_index("pair_id")
    failed = pairs[pairs.status == "failed"].reason
    scored = pairs[pairs.status == "scored"].drop(columns=["status", "reason"])
    first = scored.groupby(rows.real.reindex(scored.index)).transform("first")
    differs = ~((scored == first) | (scored.isna() & first.isna())).all(axis=1)
    first_of_kind = {}
    for name in sorted(poisoned):
        first_of_kind.setdefault(poisoned[name], name)
    return {
        "pairs": len(rows),
        "scored": len(scored),
        "failed": len(failed),
        "neither": len(rows) - len(pairs),
        "poison that was scored": sorted(set(poisoned) & set(scored.index)),
        "others that failed": {
            name: failed[name] for name in failed.index if name not in poisoned
        },
        "rows unlike their first like": int(differs.sum()),
        "reasons": {kind: failed.get(name) for kind, name in first_of_kind.items()},
    }


def draw(path):
    """The memory of command and workers over time, from the samples beside the figure."""
    mpl.use("agg")
    from matplotlib import pyplot as plt

    samples = pd.read_csv(Path(path).with_suffix(".csv"))
    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    for column, name in NAMES.items():
        axes.plot(samples.seconds / 60, samples[column], label=name, linewidth=1)
    axes.set(xlabel="minutes", ylabel="resident memory, MiB", ylim=(0, None))
    axes.legend(loc="center", frameon=False)
    figure.savefig(path, dpi=120)


def growth(sizes):
    """Mean of the second and of the last quarter of the samples, and their largest, MiB."""
    n = len(sizes) // 4
    return round(sizes[n : 2 * n].mean()), round(sizes[-n:].mean()), round(sizes.max())


def reading_s(out, begun):
    """Seconds from the start of the command to the first table: what starting and reading all files takes."""
    return min(path.stat().st_mtime for path in (out / "ground").iterdir()) - begun


def main(n_pairs=5000, points=300, seconds_between_kills=60, figure=None):
    n_pairs = int(n_pairs)
    print(machine(), "load", os.getloadavg())
    with scratch() as folder:
        data = folder / "small"
        out = folder / f"load-run{n_pairs}"
        listed = folder / f"load{n_pairs}"
        if not data.exists():
            weigh(
                "synth",
                data,
                "--pairs",
                min(N_FILES, n_pairs),
                "--points",
                points,
                "--workers",
                WORKERS,
            )
        poisoned = poison(repeated(data, n_pairs, listed))
        install_reader(folder / f"site{n_pairs}")
        paths = [str(folder / f"site{n_pairs}"), os.environ.get("PYTHONPATH")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
        words = ("run", listed, "--out", out, "--workers", WORKERS)
        harmed = Harmed(words, float(seconds_between_kills), folder / "errors.txt", environment)
        if figure:
            harmed.samples.to_csv(Path(figure).with_suffix(".csv"), index=False)
            draw(figure)
        found = judge(out, listed, poisoned)
        first_s = reading_s(out, harmed.begun)
        told = (folder / "errors.txt").read_text()
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
        left = [str(path) for path in out.rglob(".*") if path.name not in (".lock", ".writer")]
        status = subprocess.run(
            [FIDPIPE, "status", out],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        begun = time.monotonic()
        again = subprocess.run(
            [FIDPIPE, *map(str, words)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        again_s = time.monotonic() - begun
        found_again = judge(out, listed, poisoned)
    print(json.dumps(found, indent=1))
    print(
        f"exit code {harmed.code}, {harmed.wall_s:.0f} s wall, {first_s:.0f} s of them until the first table",
        end=", ",
    )
    print(f"{harmed.n_killed} workers killed, load {os.getloadavg()}")
    print(
        f"tracebacks told: {told.count('Traceback')}; temporary files left: {left}; {size / 1e6:.0f} MB"
    )
    for column, name in NAMES.items():
        second, last, most = growth(harmed.samples[column])
        print(
            f"memory of {name}: {second} MiB in the second quarter of the run, {last} in the last; at most {most}"
        )
    print(f"status: exit code {status.returncode}\n{status.stdout}")
    # those name the worker
    is_same = all(found_again[name] == of for name, of in found.items() if name != "reasons")
    print(f"second run: exit code {again.returncode}, {again_s:.1f} s, the same: {is_same}")


if __name__ == "__main__":
    draw(sys.argv[2]) if sys.argv[1:2] == ["draw"] else main(*sys.argv[1:])
