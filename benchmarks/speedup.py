"""How much faster than the method written by hand, and are the numbers the same?

    python benchmarks/speedup.py ../shared/data/kitti_twin [PAIR]

Both on the same pair, one after the other, one BLAS thread: first each with its own Louvain, fidpipe as the command
with two workers, start-up and files included; then both with fidpipe's labels, and all tables compared.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import textbook_pipeline
from measure import machine, scratch, weigh

TOLERANCE = 1e-6


def main(dataset, pair="000000"):
    print(machine())
    with scratch() as folder:
        out = folder / "speedup"
        ours = weigh(
            "run", dataset, "--out", out, "--workers", 2, "--pairs", pair, "--from", "ground"
        )
        points = {}
        labels = {}
        for side in ("real", "sim"):
            ground = pd.read_parquet(out / "ground" / f"{pair}.{side}.parquet")
            points[side] = ground.loc[~ground.is_ground, ["x", "y", "z"]].to_numpy()
            labels[side] = pd.read_parquet(
                out / "communities" / f"{pair}.{side}.parquet"
            ).community_id.to_numpy()
        metrics = pd.read_parquet(out / "metrics" / f"{pair}.parquet")
    _, seconds = textbook_pipeline.evaluate(points["real"], points["sim"])
    total = sum(seconds.values())
    print(f"pair {pair}, {len(points['real'])} and {len(points['sim'])} object points")
    print(f"by hand, own Louvain   {total:7.1f} s  ({steps(seconds)})")
    print(
        f"fidpipe, two workers   {ours.wall_s:7.1f} s wall, {ours.cpu_s:.1f} s CPU: {total / ours.wall_s:.1f} times"
    )
    by_hand, _ = textbook_pipeline.evaluate(points["real"], points["sim"], labels)
    names = [name for name in by_hand.columns if name in metrics.columns]
    worst = {name: largest_difference(by_hand[name], metrics[name]) for name in names}
    print(
        "same labels: largest difference "
        + ", ".join(f"{name} {value:.1e}" for name, value in worst.items())
    )
    if len(by_hand) != len(metrics) or not all(value <= TOLERANCE for value in worst.values()):
        sys.exit(f"the tables differ by more than {TOLERANCE}")
    print(f"{len(metrics)} objects agree within {TOLERANCE}")


def largest_difference(a, b):
    a = a.to_numpy(dtype=float)
    b = b.to_numpy(dtype=float)
    if len(a) != len(b) or (np.isnan(a) != np.isnan(b)).any():
        return np.inf
    return float(np.nanmax(np.abs(a - b), initial=0.0))


def steps(seconds):
    return ", ".join(
        f"{name} {value:.1f}"
        for name, value in sorted(seconds.items(), key=lambda step: -step[1])
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
