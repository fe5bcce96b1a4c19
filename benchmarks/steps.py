"""How much faster are single steps than the usual way, and are the results the same?

    python benchmarks/steps.py ../shared/data/kitti_twin

On the objects of all pairs, one thread, one after the other: eigenvalues by band reduction and by LAPACK's direct way,
of the Laplacians that are large enough for band reduction; the exact alignment and `linear_sum_assignment` on full
matrices; Louvain with our tolerance and with 1e-7.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from measure import machine, scratch, weigh
from scipy.linalg import eigvalsh
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from sknetwork.clustering import get_modularity

from fidpipe.schemas.settings import CommunitySettings
from fidpipe.stages import communities
from fidpipe.stages.communities import TOLERANCE_OPTIMISATION, find_communities
from fidpipe.stages.linalg.assignment import align_nodes
from fidpipe.stages.linalg.laplacian import induced_laplacian
from fidpipe.stages.linalg.spectrum import BANDED_FROM_NODES, eigenvalues
from fidpipe.stages.linalg.subgraph import Edges, adjacency, split_by_community

SEEDS = (0, 1, 2)


def main(dataset):
    print(machine())
    with scratch() as folder:
        out = folder / "steps"
        weigh("run", dataset, "--out", out, "--workers", 2)
        pairs = sorted(path.stem for path in (out / "metrics").glob("*.parquet"))
        sides = {
            pair: {side: read_side(out, pair, side) for side in ("real", "sim")}
            for pair in pairs
        }
        laplacians = []
        aligned = []
        for pair in pairs:
            large, nodes = read_objects(out, pair, sides[pair])
            laplacians += large
            aligned += nodes
    compare_spectra(laplacians)
    compare_alignments(aligned)
    compare_louvain([graph for graphs in sides.values() for graph in graphs.values()])


def read_side(out, pair, side):
    """Ids, points and edges of the object points of a side."""
    ground = pd.read_parquet(out / "ground" / f"{pair}.{side}.parquet")
    ground = ground[~ground.is_ground]
    ids = ground.point_id.to_numpy()
    graph = pd.read_parquet(out / "graph" / f"{pair}.{side}.parquet")
    src = np.searchsorted(ids, graph["src"]).astype(np.int32)
    dst = np.searchsorted(ids, graph["dst"]).astype(np.int32)
    return (
        ids,
        np.ascontiguousarray(ground[["x", "y", "z"]].to_numpy()),
        Edges(src, dst, graph.length_m.to_numpy()),
    )


def read_objects(out, pair, sides):
    """The Laplacians of objects that take the band, and the points that are aligned, of all objects."""
    metrics = pd.read_parquet(out / "metrics" / f"{pair}.parquet")
    selection = pd.read_parquet(out / "selection" / f"{pair}.parquet")
    objects = {}
    for side, (ids, points, edges) in sides.items():
        labels = pd.read_parquet(
            out / "communities" / f"{pair}.{side}.parquet"
        ).community_id.to_numpy()
        objects[side] = split_by_community(ids, points, edges, labels, metrics[f"{side}_id"])
    laplacians = []
    aligned = []
    for row in metrics.itertuples():
        own = selection[selection.real_id == row.real_id]
        points = []
        for side in ("real", "sim"):
            graph = objects[side][getattr(row, f"{side}_id")]
            nodes = np.searchsorted(graph.point_ids, own[f"{side}_point_id"])
            if row.n_keep >= BANDED_FROM_NODES:
                laplacians.append(induced_laplacian(graph, nodes))
            points.append(graph.points[np.sort(nodes)])
        aligned.append(points)
    return laplacians, aligned


def compare_spectra(laplacians):
    ours_s, direct_s, worst = 0.0, 0.0, 0.0
    for laplacian in laplacians:
        ours, seconds = timed(eigenvalues, laplacian)
        ours_s += seconds
        dense = laplacian.toarray(order="F")
        direct, seconds = timed(eigvalsh, dense, overwrite_a=True, check_finite=False)
        direct_s += seconds
        worst = max(worst, np.abs(ours - direct).max())
    sizes = [laplacian.shape[0] for laplacian in laplacians]
    print(
        f"eigenvalues of {len(sizes)} Laplacians of {min(sizes)} to {max(sizes)} nodes: by way of the band "
        f"{ours_s:.1f} s, direct {direct_s:.1f} s: {ours_s / direct_s:.2f}; largest difference {worst:.1e}"
    )


def compare_alignments(aligned):
    ours_s, direct_s, worst = 0.0, 0.0, 0.0
    for real, sim in aligned:
        cost = cdist(real - real.mean(axis=0), sim - sim.mean(axis=0))
        ours, seconds = timed(align_nodes, real, sim)
        ours_s += seconds
        direct, seconds = timed(linear_sum_assignment, cost)
        direct_s += seconds
        rows = np.arange(len(ours))
        worst = max(worst, abs(cost[rows, ours].sum() / cost[direct].sum() - 1))
    print(
        f"alignment of {len(aligned)} objects: {ours_s:.1f} s, linear_sum_assignment {direct_s:.1f} s: "
        f"{ours_s / direct_s:.2f}; largest relative difference of a sum {worst:.1e}"
    )


def compare_louvain(sides):
    for tolerance in (TOLERANCE_OPTIMISATION, 1e-7):
        communities.TOLERANCE_OPTIMISATION = tolerance
        seconds = 0.0
        modularities = []
        for ids, _, edges in sides:
            for seed in SEEDS:
                settings = CommunitySettings(seed=seed)
                labels, spent = timed(find_communities, len(ids), edges, settings)
                seconds += spent
                modularities.append(get_modularity(adjacency(len(ids), edges), labels))
        print(
            f"Louvain on {len(sides)} graphs with {len(SEEDS)} seeds, tol_optimization {tolerance:g}: {seconds:.1f} s, "
            f"mean modularity {np.mean(modularities):.5f}"
        )


def timed(function, *args, **options):
    start = time.process_time()
    result = function(*args, **options)
    return result, time.process_time() - start


if __name__ == "__main__":
    main(Path(sys.argv[1]))
