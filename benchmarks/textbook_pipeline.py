"""The method as one would write it by hand from the paper: networkx, python-louvain, dense matrices, no optimisation.

Each step does what DESIGN defines, by the library that comes to mind first. `seconds` tells where the time went.
"""

from time import perf_counter

import community as python_louvain
import networkx as nx
import numpy as np
import pandas as pd
from scipy.linalg import eigvalsh, expm
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

K, TAU_M, DELTA_M, T = 90, 0.2, 5.0, 1.0


class Clock:
    """Adds up seconds by step."""

    def __init__(self):
        self.seconds = {}
        self.last = perf_counter()

    def lap(self, step):
        now = perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - self.last
        self.last = now


def evaluate(real, sim, labels=None):
    """Table of matched objects, as `metrics` has it, and seconds by step.

    Parameters
    ----------
    real, sim : (n, 3), (m, 3) object points, metres
    labels : communities of each side, to be taken instead of finding them
    """
    clock = Clock()
    points = {"real": real, "sim": sim}
    graphs = {side: graph(points[side]) for side in points}
    clock.lap("graph")
    if labels is None:
        labels = {side: communities(graphs[side]) for side in points}
    clock.lap("communities")
    members = {}
    centroids = {}
    for side in points:
        members[side] = [
            np.flatnonzero(labels[side] == i) for i in range(labels[side].max() + 1)
        ]
        centroids[side] = [points[side][rows].mean(axis=0) for rows in members[side]]
    rows = []
    for i, j, distance in match(centroids["real"], centroids["sim"]):
        own = {"real": members["real"][i], "sim": members["sim"][j]}
        n_keep = min(len(own["real"]), len(own["sim"]))
        kept = {}
        reduced = {}
        for side in points:
            A = nx.to_numpy_array(
                graphs[side].subgraph(own[side]), nodelist=own[side].tolist(), weight="weight"
            )
            clock.lap("subgraph")
            influence = np.round(expm(-T * laplacian(A)).sum(axis=1), 9)
            clock.lap("heat")
            order = np.lexsort((own[side], -influence))[:n_keep]
            kept[side] = own[side][order]
            reduced[side] = laplacian(A[np.ix_(order, order)])
            clock.lap("laplacian")
        a = real[kept["real"]]
        b = sim[kept["sim"]]
        a_centred = a - a.mean(axis=0)
        b_centred = b - b.mean(axis=0)
        _, aligned = linear_sum_assignment(cdist(a_centred, b_centred))
        clock.lap("alignment")
        L_real = reduced["real"]
        L_sim = reduced["sim"][np.ix_(aligned, aligned)]
        values = eigvalsh(L_real), eigvalsh(L_sim)
        change = np.abs(eigvalsh(L_sim - L_real)).max() if n_keep else 0.0
        clock.lap("spectra")
        gaps = [of[1] - of[0] if n_keep > 1 else np.nan for of in values]
        shift = np.abs(values[1] - values[0]).max()
        few = 0.0 if n_keep >= 3 else np.nan  # fewer than three points have no shape
        scored = n_keep >= 3 and change > 1e-5
        cdc = density_aware(points["real"][own["real"]], points["sim"][own["sim"]])
        clock.lap("cdc")
        rows.append(
            {
                "real_id": i,
                "sim_id": j,
                "n_keep": n_keep,
                "centroid_distance_m": distance,
                "cdc": cdc,
                "r_lambda": shift / change if scored else few,
                "r_gap": abs(gaps[1] - gaps[0]) / (2 * change) if scored else few,
                "max_eigenvalue_shift": shift if n_keep >= 3 else np.nan,
                "laplacian_change": change if n_keep >= 3 else np.nan,
                "eigenspectrum_distance": np.linalg.norm(values[1] - values[0])
                if n_keep >= 3
                else np.nan,
                "gap_real": gaps[0] if n_keep >= 3 else np.nan,
                "gap_sim": gaps[1] if n_keep >= 3 else np.nan,
                "alignment_rms_m": np.sqrt(
                    np.mean(np.sum((a_centred - b_centred[aligned]) ** 2, axis=1))
                ),
            }
        )
    return pd.DataFrame(rows), clock.seconds


def graph(points):
    tree = cKDTree(points)
    G = nx.Graph()
    G.add_nodes_from(range(len(points)))
    distances, others = tree.query(points, K + 1)
    for i in range(len(points)):
        for distance, j in zip(distances[i].tolist(), others[i].tolist(), strict=True):
            if j != i:
                G.add_edge(i, j, weight=float(np.float32(distance)))
    for i, j in tree.query_pairs(TAU_M):
        G.add_edge(i, j, weight=float(np.float32(np.linalg.norm(points[i] - points[j]))))
    return G


def communities(G):
    found = python_louvain.best_partition(G, random_state=0)
    members = {}
    for node, label in found.items():
        members.setdefault(label, []).append(node)
    labels = np.empty(len(G), dtype=int)
    for new, own in enumerate(
        sorted(members.values(), key=lambda nodes: (-len(nodes), min(nodes)))
    ):
        labels[own] = new
    return labels


def match(real, sim):
    used = set()
    for i, centroid in enumerate(real):
        free = [
            (float(np.linalg.norm(centroid - other)), j)
            for j, other in enumerate(sim)
            if j not in used
        ]
        if free and min(free)[0] < DELTA_M:
            distance, j = min(free)
            used.add(j)
            yield i, j, distance


def laplacian(A):
    degree = A.sum(axis=1)
    scale = np.where(degree > 0, 1 / np.sqrt(np.where(degree > 0, degree, 1)), 0)
    return np.diag((degree > 0).astype(float)) - scale[:, None] * A * scale


def density_aware(real, sim):
    d_real = cKDTree(sim).query(real)[0]
    d_sim = cKDTree(real).query(sim)[0]
    return np.mean(1 - np.exp(-(d_real**2))) + np.mean(1 - np.exp(-(d_sim**2)))
