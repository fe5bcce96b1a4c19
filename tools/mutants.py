"""Changes the stages in one place after the other, runs them on two small pairs, and counts what `verify` finds.

    python tools/mutants.py [NUMBER ...]

Each is a copy of the package with one line changed, run and verified under both presets. The table is Markdown.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from multiprocessing.pool import ThreadPool
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from scenes import box, drifted, grid, rigid, street, write_bin

ROOT = Path(__file__).parents[1]
COMMON = ["ground.max_variance_loss=0.0003", "graph.tau_m=0.25"]
RUNS = {"paper": [*COMMON, "graph.k=12", "matching.delta_m=6"], "reference": [*COMMON, "graph.k=4"]}

#: File below `stages`, its text, and what stands there instead.
MUTANTS = (
    ("clean", "range_m < settings.min_range_m", "range_m <= settings.min_range_m"),
    ("clean", "range_m[~near] > settings.max_range_m", "range_m[~near] >= settings.max_range_m"),
    ("clean", "(points**2).sum(axis=1)", "(points[:, :2] ** 2).sum(axis=1)"),
    ("clean", "points @ T_real_sim[:, :3].T", "points @ T_real_sim[:, :3]"),
    ("clean", "repeats[order[1:]]", "repeats[order[:-1]]"),
    ("ground", "is_ground = height < threshold_m\n\n", "is_ground = height <= threshold_m\n\n"),
    ("ground", "NEAR_M = 30.0", "NEAR_M = 12.0"),
    ("ground", "np.median(in_order[start : end[start]])", "np.mean(in_order[start : end[start]])"),
    ("ground", "STEP_M = 0.05", "STEP_M = 0.04"),
    ("ground", "removed & (height > peak_m - DEPTH_M)", "removed"),
    ("graph", "k = min(settings.k, n - 1)", "k = min(settings.k - 1, n - 1)"),
    ("graph", "_distance(points, src, dst) <= tau_m", "_distance(points, src, dst) < tau_m"),
    ("graph", "np.lexsort((precedence[ball], distance))", "np.lexsort((-precedence[ball], distance))"),
    ("graph", "return np.sqrt(squared, out=squared)", "return squared"),
    ("graph", "length_m.astype(np.float32)", "length_m.astype(np.float16).astype(np.float32)"),
    ("graph", "nearest[:, 1 : k + 1]", "nearest[:, 2 : k + 2]"),
    ("communities", "np.lexsort((first, -size))", "np.lexsort((-first, -size))"),
    ("communities", "return shuffled[place]", "return shuffled[order]"),
    ("communities", "resolution=1", "resolution=0.9"),
    ("communities", "np.random.RandomState(seed)", "np.random.RandomState(seed + 1)"),
    ("objects", "own.mean(axis=0)", "np.median(own, axis=0)"),
    ("objects", "(l2 - l3) / l1", "(l2 - l3) / l2"),
    ("objects", "(-count[name], name)", "name"),
    ("matching", "is_taken[sim_id] = True", "is_taken[real_id % len(sim)] = True"),
    ("matching", "np.minimum(min_points, n_real)", "min_points"),
    ("reference", "distance_m > settings.reach_m", "distance_m > 2 * settings.reach_m"),
    ("reference", "np.bincount(groups) >= settings.min_points", "np.bincount(groups) > settings.min_points"),
    ("linalg/laplacian", "1.0 / np.sqrt(degree[joined])", "1.0 / degree[joined]"),
    ("linalg/laplacian", "normalised_laplacian(graph.adjacency[nodes][:, nodes])",
     "normalised_laplacian(graph.adjacency)[nodes][:, nodes]"),
    ("linalg/heat", "total = term.copy()\n    k = 0", "total = term * 0\n    k = 0"),
    ("linalg/assignment", "assign_nodes(real - real.mean(axis=0), sim - sim.mean(axis=0))", "assign_nodes(real, sim)"),
    ("linalg/spectrum", 'which="LM"', 'which="LA"'),
    ("selection", 'np.argsort(-influence, kind="stable")', 'np.argsort(influence, kind="stable")[::-1]'),
    ("selection", "sim_nodes[align_nodes(real.points[real_nodes], sim.points[sim_nodes])]",
     "sim_nodes[np.argsort(align_nodes(real.points[real_nodes], sim.points[sim_nodes]))]"),
    ("metrics", "spectrum[1] - spectrum[0]", "spectrum[2] - spectrum[0]"),
    ("metrics", "/ (2 * change)", "/ change"),
    ("metrics", "np.max(np.abs(", "np.mean(np.abs("),
    ("metrics", "np.expm1(-(to_sim**2))", "np.expm1(-to_sim)"),
    ("metrics", "induced_laplacian(sim, selection.sim_nodes)", "induced_laplacian(sim, np.sort(selection.sim_nodes))"),
    ("metrics", "np.sqrt(np.mean(np.sum(apart**2, axis=1)))", "np.mean(np.sum(apart**2, axis=1))"),
    ("coverage", "distance_m <= reach_m", "distance_m < reach_m"),
    ("coverage", "np.median(own)", "np.mean(own)"),
    ("coverage", "points @ axis < threshold_m", "points[:, 2] < threshold_m"),
    ("surface", "(NEIGHBOURS - _PLANE_PARAMETERS)", "(NEIGHBOURS - 1)"),
    ("surface", "MIN_PLANARITY = 0.1", "MIN_PLANARITY = 0.2"),
    ("surface", "sim.points[nearest[is_near]] - points[active[is_near]]",
     "points[active[is_near]] - sim.points[nearest[is_near]]"),
    ("surface", "_MAX_STEPS = 20", "_MAX_STEPS = 1"),
    ("pieces", "distance_m > settings.reach_m", "distance_m >= settings.reach_m / 2"),
    ("pieces", "cKDTree(other.points)", "cKDTree(other.points[~other.is_ground])"),
    ("pieces", "centroid[:, 1], self", "centroid[:, 0], self"),
    ("summary", "ddof=1", "ddof=0"),
    ("summary", "max(n_missing, n_hallucinated)", "min(n_missing, n_hallucinated)"),
    ("summary", "np.concatenate([missing_range_m, hallucinated_range_m])", "missing_range_m"),
    ("summary", "worst * n_unmatched", "worst * min(1, n_unmatched)"),
)  # fmt: skip


def write_pairs(folder):
    """Two streets with labels, points at the very limits and small objects, one with equal distances, one turned."""
    edges = [[2.5, 0, 0], [0, 100, 0], [60, 80, 0], [12, 12, 3], [0.5, 0.5, 6], [-20, -20, 4]]
    below = np.column_stack([np.arange(6), np.arange(6) + 4, -3 - 0.2 * np.arange(6)])
    few, metre = box([-25, 25, 2], [0.6] * 3, 5), [[-19, -20, 4]]
    T = rigid(15, [0.5, -0.25, 0.125])
    for seed, name in enumerate(("a", "turned")):
        lattice = grid(*[np.arange(4) * 0.125] * 3) + [9, -6, 1] if name == "a" else np.empty((0, 3))
        real = np.vstack([street(seed, 70), below])
        sim = np.vstack([drifted(real, seed), lattice, few, metre, box([15, 15, 2], [0.5] * 3, 8)])
        real = np.vstack([real, edges, lattice, few])
        own = (sim - T[:, 3]) @ T[:, :3] if name == "turned" else sim
        for side, points in (("real", real), ("sim", np.vstack([own, own[:20]]))):
            scan = write_bin(folder / f"{side}-{name}.bin", points)
            ((points[:, 0] > points[:, 1]) + 1).astype("<u4").tofile(scan.with_suffix(".label"))
    rows = f"a,real-a.bin,sim-a.bin,\nturned,real-turned.bin,sim-turned.bin,{' '.join(map(repr, T.ravel().tolist()))}"
    (folder / "pairs.csv").write_text(f"pair_id,real,sim,T_real_sim\n{rows}\n")


def verdict(mutant, data):
    """How a mutant, or the package as it is, comes off: found in these tables, not run to its end, or not found."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / "fidpipe"
        for part in ("pipeline", "schemas", "stages"):
            shutil.copytree(ROOT / part, package / part)
        shutil.copy(ROOT / "__init__.py", package)
        if mutant:
            path = package / "stages" / f"{mutant[0]}.py"
            assert mutant[1] in path.read_text(), mutant
            path.write_text(path.read_text().replace(mutant[1], mutant[2]))
        env = os.environ | {"PYTHONPATH": folder, "PYTHONPYCACHEPREFIX": folder}
        words = [sys.executable, __file__, "--one", str(data), folder]
        ended = subprocess.run(words, capture_output=True, text=True, check=False, env=env)
        return ended.stdout.strip() if not ended.returncode else f"ended with: {ended.stderr.strip().splitlines()[-1]}"


def run_and_verify(data, out):
    from fidpipe.pipeline.verify.verify import verify_run
    from fidpipe.schemas.settings import load
    from runs import run

    wrong = []
    for preset, words in RUNS.items():
        if failures := run(data, out / preset, load(None, words, preset=preset)).failures:
            sys.exit(f"{preset}: {failures[0]}")
        wrong += [mismatch.table for mismatch in verify_run(out / preset, None).mismatches]
    print(", ".join(dict.fromkeys(wrong)) or "not found")


def main(numbers):
    """Prints a row for each mutant, and how many were found."""
    with tempfile.TemporaryDirectory() as data:
        write_pairs(Path(data))
        assert verdict(None, data) == "not found", "the package as it is must agree"
        chosen = [MUTANTS[i] for i in numbers] or MUTANTS
        found = dict(zip(chosen, ThreadPool(2).map(lambda mutant: verdict(mutant, data), chosen), strict=True))
    print("| stage | was | is | found in |\n|---|---|---|---|")
    for (stage, old, new), words in found.items():
        print(f"| {stage} | `{old.strip()}` | `{new.strip()}` | {words} |")
    print(f"\n{sum(words != 'not found' for words in found.values())} of {len(found)} found")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        run_and_verify(*map(Path, sys.argv[2:]))
    else:
        main([int(word) for word in sys.argv[1:]])
