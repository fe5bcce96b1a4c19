"""Small scans built by hand, shared by all tests."""

from pathlib import Path

import numpy as np

from fidpipe.schemas.settings import load
from fidpipe.stages.graph import graph_of


def seeded(seed=3):
    return np.random.default_rng(seed)


def road(n=1200, half_width=18.0, z=-1.7, seed=0):
    """Points of a flat road around the sensor, 1 cm rough."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-half_width, half_width, (n, 2)), z + rng.normal(0, 0.01, n)]
    )


def box(centre, size, n, seed=0):
    """Points on the faces of an axis-aligned box."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (n, 3))
    axis = rng.integers(0, 3, n)
    points[np.arange(n), axis] = rng.choice([-0.5, 0.5], n)
    return np.asarray(centre) + points * np.asarray(size)


def street(seed=0, n=150):
    """A road with a car, a tree crown, a wall and a pole, well apart: about 4 objects."""
    rng = np.random.default_rng(seed)
    crown = np.array([-9.0, 6.0, 2.0]) + rng.normal(0, 0.8, (n, 3))
    return np.vstack(
        [
            road(seed=seed),
            box([8, 4, -0.9], [4, 1.8, 1.2], n, seed + 1),
            crown,
            box([2, -10, 0.5], [8, 0.2, 3], 2 * n, seed + 2),
            box([-8, -9, 0.5], [0.2, 0.2, 3.5], n // 2, seed + 3),
        ]
    )


def drifted(points, seed=0, noise=0.05, keep=0.8):
    """The same scene as a poor simulator sees it: noise, missing points, one object gone."""
    rng = np.random.default_rng(seed)
    kept = points[rng.random(len(points)) < keep]
    kept = kept[~((kept[:, 0] < -7) & (kept[:, 1] < -8) & (kept[:, 2] > -1.5))]
    return kept + rng.normal(0, noise, kept.shape)


def rigid(angle_deg, translation):
    """[R | t] of a turn about +Z and a shift."""
    a = np.radians(angle_deg)
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return np.column_stack([R, translation])


def moved(points, T):
    return points @ T[:, :3].T + T[:, 3]


def write_bin(path: Path, points, columns=4):
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.zeros((len(points), columns), dtype="<f4")
    rows[:, : np.shape(points)[1]] = points
    rows.tofile(path)
    return path


def write_pair(folder: Path, real, sim, name="a", labels=None):
    """A dataset folder with a pair more; `labels` gives a number for each point."""
    for side, points in (("real", real), ("sim", sim)):
        path = write_bin(folder / side / f"{name}.bin", points)
        if labels is not None:
            labels(points).astype("<u4").tofile(path.with_suffix(".label"))
    return folder


def write_dataset(folder: Path, n_pairs=3, n=150):
    """A dataset folder of small streets, named 000, 001, ..."""
    for i in range(n_pairs):
        scan = street(seed=10 * i, n=n)
        write_pair(folder, scan, drifted(scan, seed=i), f"{i:03}")
    return folder


def subgraph(points, k=8):
    """The points as one object, with its graph."""
    return graph_of(points, load(None, [f"graph.k={k}"]).graph)


def cloud(n=60, seed=0):
    """Points of a round cloud, 11 m from the sensor."""
    return np.array([10.0, 5.0, 1.0]) + np.random.default_rng(seed).normal(0, 1, (n, 3))


def grid(*axes):
    """The points of a lattice."""
    return (
        np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float64)
    )


def degenerate_scenes():
    """Degenerate pairs by description: a real and a simulated scan, some at the limits of float64."""
    some = cloud()
    line = np.outer(np.arange(40.0), [1, 0.5, 0.2]) + [3, 3, 1]
    plane = np.column_stack([np.random.default_rng(1).uniform(5, 15, (80, 2)), np.ones(80)])
    lattice = grid(*[np.arange(5.0)] * 3) + [5, 5, 0]
    crumbs = np.repeat(grid(np.arange(-45, 45, 4.0), np.arange(-45, 45, 4.0), [3.0]), 2, axis=0)
    crumbs[::2] += 0.01
    giant = [6, 0, 1] + np.random.default_rng(2).normal(0, 0.02, (600, 3))
    broken = np.where(np.random.default_rng(3).random(some.shape) < 0.2, np.nan, some)
    sides = {
        "no point": (some[:0], some[:0]),
        "one point": (some[:1], some[:1]),
        "two points": (some[:2], some[:2]),
        "eight points, the fewest that are enough": (some[:8], some[:8]),
        "no simulated point": (some, some[:0]),
        "all points equal": (np.full((50, 3), 5.0), np.full((50, 3), 5.0)),
        "every point several times": (np.repeat(some, 3, axis=0), np.repeat(some, 2, axis=0)),
        "points a rounding apart": (np.vstack([some, np.nextafter(some, 99)]), some),
        "on a line": (line, line[::2] + [0, 0.1, 0]),
        "on a vertical line": (
            (line - line[0]) * [0, 0, 1] + [5, 5, 0],
            (line[::2] - line[0]) * [0, 0, 1] + [5, 5, 0],
        ),
        "in a plane": (plane, plane[:-9]),
        "a lattice, all distances tied": (lattice, lattice[:-7]),
        "one giant community": (giant, giant[:-50]),
        "couples of points, 4 m apart": (crumbs, crumbs[:-3]),
        "fewer points than graph.k": (some[:12], some[:10]),
        "nothing but road on the real side": (road(300) * [1, 1, 0] - [0, 0, 1.7], street()),
        "the simulated side out of reach": (some, some + [60, 0, 0]),
        "a fifth of the coordinates NaN": (broken, some),
        "a fifth of the coordinates infinite": (np.where(np.isnan(broken), np.inf, some), some),
        "nothing but NaN": (some * np.nan, some),
        "a street at 1e6 m (projected)": (
            street() + [1e6, 1e6, 0],
            drifted(street()) + [1e6, 1e6, 0],
        ),
        "one point at 1e9 m": (np.vstack([some, [9e8, 0, 0]]), some),
        "one point at 1e300 m": (np.vstack([some, [1e300, 0, 0]]), some),
        "the largest float64 of either sign": (
            np.sign(some - cloud(1)) * np.finfo(np.float64).max,
            some,
        ),
        "two scales, 1 and 1e-200": (np.vstack([some, some * 1e-200]), some),
    }
    for exponent in (300, 40, 12, -10, -50, -162, -200, -310):
        sides[f"a cloud times 1e{exponent}"] = (
            some * 10.0**exponent,
            some[:-9] * 10.0**exponent,
        )
    return sides
