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
from measure import machine, repeated, scratch, weigh
from scipy.linalg import eigvalsh
from scipy.spatial import cKDTree

from fidpipe.stages.linalg.laplacian import induced_laplacian
from fidpipe.stages.linalg.subgraph import Edges, split_by_community

REPEATS = 3


def main(dataset, every):
    print(machine())
    # smaller pairs take less time, and the noise of a start would show
    repeats = REPEATS * every
    with scratch() as folder:
        if every > 1:
            dataset = thinned(dataset, every, folder / "thinned")
        out = folder / "floor"
        whole = weigh("run", dataset, "--out", out, "--workers", 2, "--from", "ground")
        pairs = sorted(path.stem for path in (out / "metrics").glob("*.parquet"))
        floors = {pair: floor(out, pair) for pair in pairs}
        size_mb = (
            sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
            / 1e6
            / len(pairs)
        )
        again = repeated(dataset, repeats * len(pairs), folder / "again")
        more = weigh("run", again, "--out", folder / "more", "--workers", 2, "--from", "ground")
        timings = pd.read_parquet(folder / "floor" / "timings.parquet")
        timings_of_more = pd.read_parquet(folder / "more" / "timings.parquet")
    total = sum(floors.values())
    print(
        "floor by pair: " + ", ".join(f"{pair} {value:.1f}" for pair, value in floors.items())
    )
    print(f"floor {total:.1f} s; the command on two workers:")
    print(f"  CPU  {whole.cpu_s:.1f} s, {whole.cpu_s / total:.2f} times the floor")
    print(f"  wall {whole.wall_s:.1f} s, {whole.wall_s / total:.2f} times the floor")
    pace = (more.wall_s - whole.wall_s) / ((repeats - 1) * len(pairs))
    start_s = whole.wall_s - pace * len(pairs)
    print(
        f"  start-up aside: {pace:.2f} s per pair (from {repeats} times as many pairs); start-up {start_s:.1f} s"
    )
    print(f"run directory {size_mb:.1f} MB per pair")
    inside_once, files_once = split(timings)
    inside, files = split(timings_of_more)
    inside -= inside_once
    files -= files_once
    waiting = 2 * (more.wall_s - whole.wall_s) - inside - files
    print(
        f"of {(repeats - 1) * len(pairs)} further pairs: stages {inside:.1f} s, tables {files:.1f} s, ",
        end="",
    )
    print(
        f"scheduling and waiting {waiting:.1f} s: both together {(files + waiting) / inside:.1%} of the stages"
    )
    print(timings.groupby(["stage", "step"]).seconds.sum().round(2).to_string())


def split(timings):
    """Seconds inside the stages, and of reading and writing tables."""
    is_file = timings.step.isin(["read", "write"])
    return timings.seconds[~is_file].sum(), timings.seconds[is_file].sum()


def floor(out, pair):
    """CPU seconds that no implementation of these definitions can avoid."""
    metrics = pd.read_parquet(out / "metrics" / f"{pair}.parquet")
    selection = pd.read_parquet(out / "selection" / f"{pair}.parquet")
    spent = 0.0
    objects = {}
    for side in ("real", "sim"):
        ground = pd.read_parquet(out / "ground" / f"{pair}.{side}.parquet")
        ground = ground[~ground.is_ground]
        ids = ground.point_id.to_numpy()
        points = np.ascontiguousarray(ground[["x", "y", "z"]].to_numpy())
        graph = pd.read_parquet(out / "graph" / f"{pair}.{side}.parquet")
        labels = pd.read_parquet(
            out / "communities" / f"{pair}.{side}.parquet"
        ).community_id.to_numpy()
        edges = Edges(
            np.searchsorted(ids, graph.src),
            np.searchsorted(ids, graph.dst),
            graph.length_m.to_numpy(),
        )
        objects[side] = split_by_community(ids, points, edges, labels, metrics[f"{side}_id"])
        start = time.process_time()
        tree = cKDTree(points)
        tree.query(points, 91)
        tree.query_pairs(0.2, output_type="ndarray")
        spent += time.process_time() - start
    for row in metrics.itertuples():
        real = objects["real"][row.real_id]
        sim = objects["sim"][row.sim_id]
        start = time.process_time()
        cKDTree(sim.points).query(real.points)
        cKDTree(real.points).query(sim.points)
        spent += time.process_time() - start
        own = selection[selection.real_id == row.real_id]
        for graph, column in ((real, "real_point_id"), (sim, "sim_point_id")):
            if row.n_keep < 3:
                continue
            dense = induced_laplacian(
                graph, np.searchsorted(graph.point_ids, own[column])
            ).toarray()
            start = time.process_time()
            eigvalsh(dense)
            spent += time.process_time() - start
    return spent


def thinned(dataset, every, out):
    """A copy of a KITTI dataset with every so-manieth row of each file."""
    for side in ("real", "sim"):
        (out / side).mkdir(parents=True, exist_ok=True)
        for path in sorted((dataset / side).glob("*.bin")):
            np.fromfile(path, dtype=np.float32).reshape(-1, 4)[::every].tofile(
                out / side / path.name
            )
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--every", type=int, default=1)
    asked = parser.parse_args()
    main(asked.dataset, asked.every)
