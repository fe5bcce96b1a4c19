"""Running the command and weighing it: wall and CPU seconds, and the memory of its processes."""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
import psutil

FIDPIPE = Path(sys.executable).with_name("fidpipe")
MIB = 2**20


@dataclass
class Weighed:
    """A command that was run.

    wall_s, cpu_s : of it and all its processes
    peaks : by process, its largest resident memory in MiB; the first is the command (with the scheduler in it)
    """

    wall_s: float
    cpu_s: float
    peaks: list = field(default_factory=list)
    output: str = ""


def weigh(*words):
    """Runs `fidpipe WORDS` to its end. FIDPIPE_BENCH_COMMAND names another command, to weigh another version of it."""
    command = os.environ.get("FIDPIPE_BENCH_COMMAND", FIDPIPE)
    start = time.perf_counter()
    process = subprocess.Popen(
        [command, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    peaks = {}
    seconds = {}
    watcher = threading.Thread(target=_watch, args=(process, peaks, seconds))
    watcher.start()
    output, errors = process.communicate()
    wall_s = time.perf_counter() - start
    watcher.join()
    if process.returncode:
        sys.exit(f"fidpipe {' '.join(map(str, words))}: exit {process.returncode}\n{errors}")
    return Weighed(wall_s, sum(seconds.values()), list(peaks.values()), output)


@contextmanager
def scratch():
    """A folder for a benchmark's runs; FIDPIPE_BENCH_DIR keeps it."""
    kept = os.environ.get("FIDPIPE_BENCH_DIR")
    folder = Path(kept or tempfile.mkdtemp(prefix="fidpipe-bench-"))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield folder
    finally:
        if not kept:
            shutil.rmtree(folder)


def repeated(dataset, n_pairs, out):
    """A manifest of this many pairs: those of a dataset, repeated under other names."""
    listed = dataset / "pairs.csv"
    if listed.exists():
        rows = pd.read_csv(listed)
    else:
        names = sorted(
            path.name for path in (dataset / "real").iterdir() if path.suffix == ".bin"
        )
        rows = pd.DataFrame(
            {
                "real": [f"real/{name}" for name in names],
                "sim": [f"sim/{name}" for name in names],
            }
        )
    rows = pd.concat([rows] * -(-n_pairs // len(rows)), ignore_index=True).head(n_pairs)
    rows["pair_id"] = [f"{i:06d}" for i in range(n_pairs)]
    for side in ("real", "sim"):
        rows[side] = [str((dataset / path).resolve()) for path in rows[side]]
    out.mkdir(parents=True, exist_ok=True)
    rows.to_csv(out / "pairs.csv", index=False)
    return out


def machine():
    """One line on the machine."""
    model = (
        next((of for of in _cpuinfo() if of.startswith("model name")), "")
        .partition(":")[2]
        .strip()
    )
    return (
        f"{model or platform.processor()}, {os.cpu_count()} cores, {psutil.virtual_memory().total / 2**30:.0f} GiB, "
        f"Python {platform.python_version()}"
    )


def _cpuinfo():
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def _watch(process, peaks, seconds):
    """Looks at the command and all that it started, each tenth of a second: of what ends less than that is lost."""
    while process.poll() is None:
        try:
            family = [
                psutil.Process(process.pid),
                *psutil.Process(process.pid).children(recursive=True),
            ]
        except psutil.NoSuchProcess:
            return
        for member in family:
            try:
                peaks[member.pid] = max(
                    peaks.get(member.pid, 0), member.memory_info().rss / MIB
                )
                times = member.cpu_times()
                seconds[member.pid] = times.user + times.system
            except psutil.Error:
                continue
        time.sleep(0.1)
