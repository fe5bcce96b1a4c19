"""What only tests ask for: all permutations tried, the reference implementation of Louvain, ties told apart.

The definitions themselves, slow and obvious, are `fidpipe.stages.literal`.
"""

import itertools
import math

import community as python_louvain
import networkx as nx
import numpy as np

from fidpipe.stages.literal import method


def louvain(n, edges, seed=0):
    """Labels by python-louvain, in canonical order."""
    G = nx.Graph()
    G.add_nodes_from(range(n))
    G.add_weighted_edges_from((i, j, float(length)) for (i, j), length in edges.items())
    label_by_node = python_louvain.best_partition(G, random_state=seed)
    return np.array(method.canonical([label_by_node[i] for i in range(n)]))


def match_optimal(real, sim, delta):
    """The most pairs nearer than delta, at the least total distance, by trying all."""
    best = (0, 0.0, [])
    wide = list(range(len(sim))) + [None] * len(real)
    for choice in itertools.permutations(wide, len(real)):
        pairs = [(i, j, math.dist(real[i], sim[j])) for i, j in enumerate(choice) if j is not None]
        pairs = [pair for pair in pairs if pair[2] < delta]
        candidate = (len(pairs), -sum(d for _, _, d in pairs), pairs)
        if candidate[:2] > best[:2] or not best[2]:
            best = candidate if candidate[:2] >= best[:2] else best
    return best[2]


def align(real, sim):
    """Total distance and permutation of the best alignment, by trying all; at most 8 nodes."""
    a, b = real - real.mean(axis=0), sim - sim.mean(axis=0)
    totals = (
        (sum(math.dist(a[i], b[j]) for i, j in enumerate(choice)), choice)
        for choice in itertools.permutations(range(len(b)))
    )
    return min(totals)


def nearest_real(real, place):
    """The real point that is nearest to a place, of equally near ones the first by x, y, z, and its distance."""
    apart = method.distances(real, place)
    closest = np.flatnonzero(apart == apart.min()).tolist()
    first = min(closest, key=lambda j: real[j].tolist())
    return first, float(apart[first])


def assigned(real, real_labels, sim, reach_m, min_points, groups_of):
    """Object of each simulated point; `groups_of(indices)` partitions those that no real point reaches."""
    near = [nearest_real(real, p) for p in sim]
    labels = [int(real_labels[j]) for j, _ in near]
    outside = [i for i, (_, apart) in enumerate(near) if apart > reach_m]
    groups = groups_of(outside)
    large = [g for g in sorted(set(groups)) if groups.count(g) >= min_points]
    for i, group in zip(outside, groups, strict=True):
        if group in large:
            labels[i] = max(real_labels) + 1 + large.index(group)
    return labels
