"""The definitions once more as a textbook has them, slow and obvious: dense matrices, loops, no other thought."""

import itertools
import math

import community as python_louvain
import networkx as nx
import numpy as np
import scipy.linalg


def clean(points, min_range_m, max_range_m, exclude_box=None, T=None, flip_y=False, include_box=None):
    """Row numbers and coordinates of the points that stay."""
    seen, kept = set(), []
    for i, p in enumerate(points.tolist()):
        if not all(math.isfinite(c) for c in p) or p == [0, 0, 0] or tuple(p) in seen:
            continue
        seen.add(tuple(p))
        if not min_range_m <= math.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2) <= max_range_m:
            continue
        if exclude_box and all(exclude_box[a] <= p[a] <= exclude_box[a + 3] for a in range(3)):
            continue
        if flip_y:
            p = [p[0], -p[1], p[2]]
        if T is not None:
            p = [sum(T[r][c] * p[c] for c in range(3)) + T[r][3] for r in range(3)]
        if include_box and not all(include_box[a] <= p[a] <= include_box[a + 3] for a in range(3)):
            continue
        kept.append((i, p))
    return [i for i, _ in kept], np.array([p for _, p in kept])


def ground(points, prior_m=0.30, max_loss=0.01, loss="removed"):
    """Flags, peak, threshold, loss, iterations of the PCA Z-cut."""
    _, vectors = np.linalg.eigh(np.cov(points.T))
    axis = max(vectors.T, key=lambda v: abs(v[2]))
    axis = axis if axis[2] > 0 else -axis
    if math.degrees(math.acos(min(1.0, axis[2]))) > 10:
        axis = np.array([0.0, 0.0, 1.0])
    height = [float(p @ axis) for p in points]
    near = sorted(h for h, p in zip(height, points, strict=True) if np.linalg.norm(p) <= 30)
    windows = [[h for h in near[i:] if h <= near[i] + 0.1] for i in range(len(near))]
    fullest = max(len(window) for window in windows)
    peak = float(np.median(next(window for window in windows if len(window) == fullest)))

    def loss_of(z):
        removed = [h < z for h in height]
        if loss == "total":
            kept = points[~np.array(removed)]
            whole = np.trace(np.cov(points.T, bias=True))
            return abs(np.trace(np.cov(kept.T, bias=True)) - whole) / whole
        counted = [h for h, r in zip(height, removed, strict=True) if r and h > peak - 1]
        mean = sum(counted) / len(counted) if counted else 0.0
        mean_all = sum(height) / len(height)
        return sum((h - mean) ** 2 for h in counted) / sum((h - mean_all) ** 2 for h in height)

    z, iterations = peak + prior_m, 0
    while loss_of(z) > max_loss and z > peak + 1e-9:
        z, iterations = max(z - 0.05, peak), iterations + 1
    return np.array([h < z for h in height]), peak, z, loss_of(z), iterations


def graph(points, k, tau, rule="union"):
    """{(i, j): distance} with i < j."""
    n = len(points)

    def distance(i, j):
        dx, dy, dz = (points[i] - points[j]).tolist()
        return math.sqrt(dx * dx + dy * dy + dz * dz)

    knn, near = set(), set()
    for i in range(n):
        others = sorted((distance(i, j), j) for j in range(n) if j != i)
        knn |= {(min(i, j), max(i, j)) for _, j in others[:k]}
        near |= {(min(i, j), max(i, j)) for d, j in others if d <= tau}
    edges = knn | near if rule == "union" else knn & near
    return {edge: np.float32(distance(*edge)) for edge in sorted(edges)}


def adjacency(n, edges):
    A = np.zeros((n, n))
    for (i, j), length in edges.items():
        A[i, j] = A[j, i] = length
    return A


def modularity(A, labels):
    """Q by its double sum."""
    k, two_m = A.sum(axis=1), A.sum()
    same = np.equal.outer(labels, labels)
    return float(((A - np.outer(k, k) / two_m) * same).sum() / two_m)


def louvain(n, edges, seed=0):
    """Labels by python-louvain, in canonical order."""
    G = nx.Graph()
    G.add_nodes_from(range(n))
    G.add_weighted_edges_from((i, j, float(length)) for (i, j), length in edges.items())
    label_by_node = python_louvain.best_partition(G, random_state=seed)
    return canonical([label_by_node[i] for i in range(n)])


def canonical(labels):
    """Communities by size, largest first, then by smallest node."""
    members = {}
    for node, label in enumerate(labels):
        members.setdefault(label, []).append(node)
    order = sorted(members.values(), key=lambda nodes: (-len(nodes), nodes[0]))
    new = {node: i for i, nodes in enumerate(order) for node in nodes}
    return np.array([new[node] for node in range(len(labels))])


def match_greedy(real, sim, delta):
    """[(real, sim, distance)] of Algorithm 1."""
    used, pairs = set(), []
    for i, p in enumerate(real):
        free = [(math.dist(p, q), j) for j, q in enumerate(sim) if j not in used]
        if free and min(free)[0] < delta:
            d, j = min(free)
            used.add(j)
            pairs.append((i, j, d))
    return pairs


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


def laplacian(A):
    """I - D^-1/2 A D^-1/2; zero rows for isolated nodes."""
    n = len(A)
    degree = A.sum(axis=1)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            if degree[i] > 0 and degree[j] > 0:
                L[i, j] = (i == j) - A[i, j] / math.sqrt(degree[i] * degree[j])
    return L


def influence(L, t):
    """Row sums of the dense heat kernel."""
    return np.round(scipy.linalg.expm(-t * L).sum(axis=1), 9)


def keep(scores, n_keep):
    """Nodes of largest influence, ties by node."""
    return sorted(range(len(scores)), key=lambda i: (-scores[i], i))[:n_keep]


def align(real, sim):
    """Total distance and permutation of the best alignment, by trying all; at most 8 nodes."""
    a, b = real - real.mean(axis=0), sim - sim.mean(axis=0)
    totals = (
        (sum(math.dist(a[i], b[j]) for i, j in enumerate(choice)), choice)
        for choice in itertools.permutations(range(len(b)))
    )
    return min(totals)


def cdc(real, sim):
    """The paper's equation by two loops."""

    def one_way(xs, ys):
        return sum(min(1 - math.exp(-(math.dist(x, y) ** 2)) for y in ys) for x in xs) / len(xs)

    return one_way(real, sim) + one_way(sim, real)


def spectral(L_real, L_sim):
    """r_lambda, r_gap and what they are made of."""
    a, b = np.linalg.eigvalsh(L_real), np.linalg.eigvalsh(L_sim)
    change = np.linalg.norm(L_sim - L_real, 2)
    shift = max(abs(b - a))
    return {
        "r_lambda": shift / change,
        "r_gap": abs((b[1] - b[0]) - (a[1] - a[0])) / (2 * change),
        "max_eigenvalue_shift": shift,
        "laplacian_change": change,
        "eigenspectrum_distance": math.sqrt(sum((b - a) ** 2)),
        "gap_real": a[1] - a[0],
        "gap_sim": b[1] - b[0],
    }


def local_plane(points, place, k=20):
    """Normal of the plane through the k points nearest to a place, roughness, planarity."""
    near = sorted(points.tolist(), key=lambda p: math.dist(p, place))[:k]
    centred = np.array(near) - np.mean(near, axis=0)
    _, sizes, axes = np.linalg.svd(centred)
    l1, l2, l3 = sizes**2 / k
    residuals = centred @ axes[2]
    return axes[2], math.sqrt(sum(residuals**2) / (k - 3)), (l2 - l3) / l1


def offset(real, sim, reach_m=1.0):
    """The translation of sim against real, point to plane, by least squares again and again."""
    planes = [(p, local_plane(real, p)) for p in real]
    planes = [(p, normal) for p, (normal, _, planarity) in planes if planarity >= 0.1]
    t = np.zeros(3)
    for _ in range(20):
        rows, wanted = [], []
        for p, normal in planes:
            q = min(sim, key=lambda q: math.dist(q, p + t))
            if math.dist(q, p + t) <= reach_m:
                rows.append(normal)
                wanted.append(normal @ (q - p))
        before, t = t, np.linalg.lstsq(np.array(rows), np.array(wanted))[0]
        if max(abs(t - before)) <= 1e-3:
            break
    return t


def area_between(real, sim):
    """Area between two empirical distribution functions, step by step."""
    steps = sorted([*real, *sim])
    return sum(
        abs(np.mean([x <= low for x in real]) - np.mean([x <= low for x in sim])) * (high - low)
        for low, high in itertools.pairwise(steps)
    )


def assigned(real, real_labels, sim, reach_m, min_points, groups_of):
    """Object of each simulated point; `groups_of(indices)` partitions those that no real point reaches."""
    labels, outside = [], []
    for i, p in enumerate(sim):
        distances = [math.dist(p, q) for q in real]
        nearest = min(range(len(real)), key=lambda j: (distances[j], j))
        labels.append(int(real_labels[nearest]))
        if distances[nearest] > reach_m:
            outside.append(i)
    groups = groups_of(outside)
    large = [g for g in sorted(set(groups)) if groups.count(g) >= min_points]
    for i, group in zip(outside, groups, strict=True):
        if group in large:
            labels[i] = max(real_labels) + 1 + large.index(group)
    return labels


def covered(points, others, reach_m):
    """Share of the points with another one within reach."""
    return sum(min(math.dist(p, q) for q in others) <= reach_m for p in points) / len(points)
