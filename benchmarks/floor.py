"""How near is fidpipe to what the definitions force?

    python benchmarks/floor.py ../shared/data/kitti_twin [--every 3]

The floor: eigvalsh of both reduced Laplacians of every matched object, and the kNN, tau and CDC queries, one BLAS
thread, in this process. Beside it the whole command, fresh, on two workers: total CPU seconds and wall seconds, and
the seconds of each stage and step. With --every 3 first the files are thinned to rows 0, 3, 6, ..., which makes
scans of the paper's size.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
from measure import machine, scratch, weigh
from scipy.linalg import eigvalsh
from scipy.spatial import cKDTree

from fidpipe.stages.graph import Edges
from fidpipe.stages.laplacian import induced_laplacian, split_by_community


def main(dataset, every):
    print(machine())
    with scratch() as folder:
        if every > 1:
            dataset = thinned(dataset, every, folder / "thinned")
        out = folder / "floor"
        whole = weigh("run", dataset, "--out", out, "--workers", 2, "--from", "ground")
        pairs = sorted(path.stem for path in (out / "metrics").glob("*.parquet"))
        floors = {pair: floor(out, pair) for pair in pairs}
        timings = pd.read_parquet(out / "timings.parquet")
        size_mb = sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / 1e6 / len(pairs)
        start_s = start_up(dataset, folder)
    total = sum(floors.values())
    print("floor by pair: " + ", ".join(f"{pair} {value:.1f}" for pair, value in floors.items()))
    print(f"floor {total:.1f} s; the command on two workers:")
    print(f"  CPU  {whole.cpu_s:.1f} s, {whole.cpu_s / total:.2f} times the floor")
    print(f"  wall {whole.wall_s:.1f} s, {whole.wall_s / total:.2f} times the floor")
    pace = (whole.wall_s - start_s) / len(pairs)
    print(f"  start-up aside (a run with nothing to do: {start_s:.1f} s): {pace:.2f} s a pair")
    print(f"run directory {size_mb:.1f} MB a pair")
    own = timings[~timings.step.isin(["read", "write"])].seconds.sum()
    files = timings.seconds.sum() - own
    waiting = 2 * (whole.wall_s - start_s) - own - files
    print(f"stages {own:.1f} s; reading and writing tables {files:.1f} s, scheduling and waiting {waiting:.1f} s:")
    print(f"  together {(files + waiting) / own:.1%} of the stages' own time")
    print(timings.groupby(["stage", "step"]).seconds.sum().round(2).to_string())


def start_up(dataset, folder):
    """Seconds of a run with nothing to do."""
    return weigh("run", dataset, "--out", folder / "floor", "--workers", 2).wall_s


def floor(out, pair):
    """CPU seconds that no implementation of these definitions can avoid."""
    metrics = pd.read_parquet(out / "metrics" / f"{pair}.parquet")
    selection = pd.read_parquet(out / "selection" / f"{pair}.parquet")
    spent, objects = 0.0, {}
    for side in ("real", "sim"):
        ground = pd.read_parquet(out / "ground" / f"{pair}.{side}.parquet")
        ground = ground[~ground.is_ground]
        ids, points = ground.point_id.to_numpy(), np.ascontiguousarray(ground[["x", "y", "z"]].to_numpy())
        graph = pd.read_parquet(out / "graph" / f"{pair}.{side}.parquet")
        labels = pd.read_parquet(out / "communities" / f"{pair}.{side}.parquet").community_id.to_numpy()
        edges = Edges(np.searchsorted(ids, graph.src), np.searchsorted(ids, graph.dst), graph.length_m.to_numpy())
        objects[side] = split_by_community(ids, points, edges, labels, metrics[f"{side}_id"])
        start = time.process_time()
        tree = cKDTree(points)
        tree.query(points, 91)
        tree.query_pairs(0.2, output_type="ndarray")
        spent += time.process_time() - start
    for row in metrics.itertuples():
        real, sim = objects["real"][row.real_id], objects["sim"][row.sim_id]
        start = time.process_time()
        cKDTree(sim.points).query(real.points)
        cKDTree(real.points).query(sim.points)
        spent += time.process_time() - start
        own = selection[selection.real_id == row.real_id]
        for graph, column in ((real, "real_point_id"), (sim, "sim_point_id")):
            if row.n_keep < 3:
                continue
            dense = induced_laplacian(graph, np.searchsorted(graph.point_ids, own[column])).toarray()
            start = time.process_time()
            eigvalsh(dense)
            spent += time.process_time() - start
    return spent


def thinned(dataset, every, out):
    """A copy of a KITTI dataset with every so-manieth row of each file."""
    for side in ("real", "sim"):
        (out / side).mkdir(parents=True, exist_ok=True)
        for path in sorted((dataset / side).glob("*.bin")):
            np.fromfile(path, dtype=np.float32).reshape(-1, 4)[::every].tofile(out / side / path.name)
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--every", type=int, default=1)
    asked = parser.parse_args()
    main(asked.dataset, asked.every)
