"""Small scans built by hand, shared by all tests."""

from pathlib import Path

import numpy as np


def road(n=1200, half_width=18.0, z=-1.7, seed=0):
    """Points of a flat road around the sensor, 1 cm rough."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-half_width, half_width, (n, 2)), z + rng.normal(0, 0.01, n)])


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
    rows[:, :3] = points
    rows.tofile(path)
    return path


def write_dataset(folder: Path, n_pairs=3, n=150):
    """A dataset folder of small streets, named 000, 001, ..."""
    for i in range(n_pairs):
        scan = street(seed=10 * i, n=n)
        write_bin(folder / "real" / f"{i:03}.bin", scan)
        write_bin(folder / "sim" / f"{i:03}.bin", drifted(scan, seed=i))
    return folder
