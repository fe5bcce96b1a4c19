"""What does a pair cost beyond its own work, and does the scheduler grow?

    python benchmarks/small_pairs.py [N_PAIRS] [POINTS]      by default 10000 pairs of 2000 points

A manifest lists each of some hundred synthetic pairs many times under different names. While the stages run: wall time
times workers less the time inside jobs, per pair; Parquet apart; memory of the command (with dask's scheduler in it)
and of the workers; the time of a second run, which has nothing to do.
"""

import json
import sys

import pandas as pd
from measure import machine, repeated, scratch, weigh

N_FILES = 250
WORKERS = 2


def main(n_pairs=10_000, points=2000):
    print(machine())
    with scratch() as folder:
        data = folder / "small"
        out = folder / f"small-run{n_pairs}"
        n_files = min(N_FILES, n_pairs)
        weigh("synth", data, "--pairs", n_files, "--points", points, "--workers", WORKERS)
        data = repeated(data, n_pairs, folder / "listed")
        run = weigh("run", data, "--out", out, "--workers", WORKERS, "--from", "ground")
        timings = pd.read_parquet(out / "timings.parquet")
        wall_s = json.loads((out / "run.json").read_text())["wall_s"]
        again = weigh("run", data, "--out", out, "--workers", WORKERS)
    is_file = timings.step.isin(["read", "write"])
    inside = timings.seconds[~is_file].sum()
    files = timings.seconds[is_file].sum()
    beyond = WORKERS * wall_s["stages"] - inside - files
    print(
        f"{n_pairs} pairs of about {points} points: {run.wall_s:.0f} s wall, {run.cpu_s:.0f} s CPU"
    )
    print(
        f"per pair: {1e3 * inside / n_pairs:.1f} ms inside the stages, {1e3 * files / n_pairs:.1f} ms Parquet, ",
        end="",
    )
    print(f"{1e3 * beyond / n_pairs:.1f} ms beyond ({beyond / (inside + files):.1%})")
    workers = ", ".join(f"{of:.0f}" for of in sorted(run.peaks[1:])[-WORKERS:])
    print(f"peak memory: command with scheduler {run.peaks[0]:.0f} MiB, workers {workers} MiB")
    print(f"nothing to do: {again.wall_s:.1f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
