"""Which score predicts what a perception stack would notice, and how good is good enough?

    python benchmarks/tasks.py ../shared/data
    python benchmarks/tasks.py ../shared/data --bases VLP-32C HDL-32E drive --amounts 0 2

Thirty-three flaws in three amounts and a control, applied to the simulated side of real scans on several bases: *good*
(two KITTI scans re-measured, 2 cm of noise along the ray and 3 % lost), *poor* (their twins), and three re-measured
scenes more: a VLP-32C in a parked car, an HDL-32E of nuScenes, and ten scans of a drive with 64 beams, over which
odometry runs as well (needs kiss-icp). KITTI scans are first reduced to every fourth row, those of the drive to every
eighth. The scores and the gaps of all tasks of each condition are kept in a CSV file. Then prints, for each base,
Spearman's rank correlation of every score with every gap over the conditions (means over the frames), its 95 % interval
from 1,000 bootstraps over flaws, its range when any one flaw is left out, the error of a monotone prediction of the gap
of a flaw that was left out, the gaps between two real measurements (neighbouring sweeps of a parked and of a driving
car; for odometry two halves of each sweep of the drive), and the scores at which the predicted gap reaches these; last,
the correlations of all bases next to each other. Stopped, it resumes; `--print` only prints.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from diagnosis import car_moved, motion, pitch, quantum, rain, raised
from flawed_scans import (
    Scan,
    along_ray,
    belongs_to_car,
    drop,
    find_car,
    find_poles,
    is_ground,
    random,
    range_limit,
    ranges,
    ray_noise,
    read,
    solid_foliage,
)
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.stats import rankdata
from sklearn.isotonic import IsotonicRegression
from unseen_flaws import (
    beams_of,
    biased,
    blind,
    cartesian,
    dead,
    describe_sensor,
    jittering,
    remeasured,
    rolled,
    spherical,
    stretched,
    turned,
    with_second_returns,
)

from fidpipe import FidpipeError
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.engine.worker import PairTables, run_in_memory
from fidpipe.pipeline.jobs.scoring import PARTITION, ground_table, score_pair
from fidpipe.schemas.settings import load
from fidpipe.stages.arrays import FloatArray
from fidpipe.stages.baselines import compare_points
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.coverage import nearest_distances
from fidpipe.stages.ground import GroundResult, remove_ground
from fidpipe.stages.odometry import compare_trajectories, trajectory
from fidpipe.stages.pieces import CutScan
from fidpipe.stages.tasks import (
    ALL,
    compare_free_space,
    compare_ground,
    compare_obstacles,
    compare_occupancy,
)

EVERY = 4
EVERY_OF_DRIVE = 8
BASES = ("good", "poor", "VLP-32C", "HDL-32E", "drive")
NONE = "none"
CONTROL = "control: range noise, m"
SETTINGS = load(
    None, ["tasks.names=all", "metrics.baselines=chamfer,f_score,dcd"], preset="reference"
)
#: Scores by column, and 1 if a larger one is worse, -1 if it is better.
SCORES = {
    "r_lambda_mean": 1,
    "eigenspectrum_distance_mean": 1,
    "r_gap_mean": 1,
    "cdc_mean": 1,
    "found": -1,
    "covered_real_0p1m": -1,
    "covered_sim_0p1m": -1,
    "dcd": 1,
    "f_score": -1,
    "chamfer_mean_m": 1,
    "log_points": 1,
}
TASKS = (
    "objects.lost",
    "objects.lost.1.5 to 6 m",
    "objects.added",
    "occupancy.mismatch",
    "occupancy.wrongly_free",
    "free_space.distance_m",
    "free_space.too_far",
    "ground.disagreement",
    "ground.height_m",
    "odometry.drift_m",
    "odometry.step_m",
    "odometry.turn_deg",
)


def moved(x_m, z_m):
    return lambda scan, rng: scan.points + np.array([x_m, 0, z_m])


def keep(condition):
    """Keeps the points for which a function of scan and random numbers is True."""
    return lambda scan, rng: scan.points[condition(scan, rng)]


def by_chance(share, concerns):
    """Loses a share of the points that a function of the scan names."""
    return keep(lambda scan, rng: ~(concerns(scan) & (rng.random(len(scan.points)) < share)))


def holes(n):
    def cut(scan, rng):
        centres = scan.points[rng.choice(len(scan.points), n, replace=False)]
        return scan.points[cKDTree(centres).query(scan.points)[0] > 1.5]

    return cut


def ghosts(share):
    """Clusters of 20 points in front of surfaces, 1.5 m from every point."""

    def add(scan, rng):
        tree = cKDTree(scan.points)
        clusters = []
        while len(clusters) < share * len(scan.points) / 20:
            centre = scan.points[rng.integers(len(scan.points))] * rng.uniform(0.2, 0.9)
            if tree.query(centre)[0] > 1.5 and np.hypot(*centre[:2]) > 4:
                clusters.append(centre + rng.normal(0, 0.2, (20, 3)))
        return np.vstack([scan.points, *clusters])

    return add


def is_pole(scan):
    return (cKDTree(scan.poles).query(scan.points[:, :2])[0] < 0.4) & ~is_ground(scan.points)


def mixed(share, *, at_edges):
    def mix(scan, rng):
        range_m = ranges(scan.points)
        rows = np.arange(len(range_m))
        if at_edges:
            step_m = np.diff(range_m, prepend=range_m[0], append=range_m[-1])
            rows = np.flatnonzero((step_m[1:] > 0.5) | (step_m[:-1] < -0.5))
        rows = rng.choice(rows, min(len(rows), round(share * len(range_m))), replace=False)
        range_m[rows] += rng.uniform(0.2, 1.5, len(rows))
        return along_ray(scan.points, range_m)

    return mix


def solid(share):
    def close(scan, rng):
        is_closed = rng.random(len(scan.points)) < share
        return np.where(is_closed[:, None], solid_foliage(scan, rng), scan.points)

    return close


def beams_exchanged(n):
    def exchange(scan, rng):
        beam, elevation_deg = beams_of(scan.points)
        range_m, azimuth, elevation = spherical(scan.points)
        for a in range(8, 8 + 2 * n, 2):
            apart = np.radians(elevation_deg[a + 1] - elevation_deg[a])
            elevation[beam == a] += apart
            elevation[beam == a + 1] -= apart
        return cartesian(range_m, azimuth, elevation)

    return exchange


def elevation_deg(scan):
    return np.degrees(spherical(scan.points)[2])


def of_points(flaw):
    """A flaw of `unseen_flaws`, which takes points, as one of a scan."""
    return lambda scan, rng: flaw(scan.points, rng)


#: Three amounts of each flaw, and the flaw of that amount.
FLAWS = {
    CONTROL: ((0.005, 0.01, 0.02), ray_noise),
    "lost points, share": ((0.1, 0.3, 0.6), drop),
    "lost beyond 25 m, share": (
        (0.3, 0.6, 0.9),
        lambda a: by_chance(a, lambda scan: ranges(scan.points) > 25),
    ),
    "lost road, share": (
        (0.3, 0.6, 0.9),
        lambda a: by_chance(a, lambda scan: is_ground(scan.points)),
    ),
    "holes of 1.5 m": ((6, 12, 24), holes),
    "ghosts in free air, share": ((0.02, 0.05, 0.1), ghosts),
    "noise along the ray, m": ((0.05, 0.1, 0.2), ray_noise),
    "offset forward, m": ((0.1, 0.2, 0.4), lambda a: moved(a, 0)),
    "offset upward, m": ((0.05, 0.1, 0.2), lambda a: moved(0, a)),
    "pitch, degrees": ((0.5, 1, 2), pitch),
    "roll, degrees": ((0.5, 1, 2), lambda a: of_points(rolled(a))),
    "yaw, degrees": ((0.4, 0.8, 1.6), lambda a: of_points(turned(a))),
    "range scale": ((0.01, 0.03, 0.06), lambda a: lambda scan, rng: scan.points * (1 + a)),
    "range bias, m": ((0.06, 0.12, 0.25), lambda a: of_points(biased(a))),
    "range quantum, m": ((0.05, 0.1, 0.3), quantum),
    "car lost, share": ((0.3, 0.6, 1), lambda a: by_chance(a, belongs_to_car)),
    "car moved, m": ((0.25, 0.5, 1), car_moved),
    "thin poles lost, share": ((0.3, 0.6, 1), lambda a: by_chance(a, is_pole)),
    "azimuths, each n-th": ((2, 3, 4), lambda a: lambda scan, rng: scan.points[::a]),
    "road raised, m": ((0.05, 0.1, 0.2), raised),
    "motion distortion, m/s": ((5, 10, 20), motion),
    "rain, points": ((50, 100, 200), rain),
    "maximum range, m": ((50, 30, 20), range_limit),
    "minimum range, m": (
        (5, 8, 12),
        lambda a: keep(lambda scan, rng: ranges(scan.points) >= a),
    ),
    "highest elevation, degrees": (
        (0, -2, -5),
        lambda a: keep(lambda scan, rng: elevation_deg(scan) <= a),
    ),
    "mixed pixels, share": ((0.01, 0.03, 0.1), lambda a: mixed(a, at_edges=False)),
    "mixed pixels at edges, share": ((0.01, 0.03, 0.1), lambda a: mixed(a, at_edges=True)),
    "solid foliage, share": ((0.3, 0.6, 1), solid),
    "blind sector, degrees": ((20, 57, 114), lambda a: of_points(blind(40, 40 + a))),
    "second returns, share": (
        (0.05, 0.1, 0.2),
        lambda a: of_points(with_second_returns(a, 1, 3)),
    ),
    "jitter of angles, degrees": ((0.05, 0.15, 0.3), lambda a: of_points(jittering(a))),
    "elevations too large, share": ((0.01, 0.02, 0.05), lambda a: of_points(stretched(a))),
    "dead beams": ((2, 6, 12), lambda a: of_points(dead(a))),
    "beams exchanged, pairs": ((1, 2, 4), beams_exchanged),
}


@dataclass
class Side:
    """A scan, cut and partitioned: what does not change while the other side does is computed once."""

    scan: CutScan
    cut: GroundResult
    points: FloatArray
    tables: PairTables


def prepare(points, real=None):
    """The real side, or the simulated one of a real side."""
    clean = clean_scan(points, SETTINGS.input)
    real_side = (real.cut, real.scan.points) if real else ()
    cut = remove_ground(clean.points, SETTINGS.ground, *real_side)
    side = "real" if real is None else "sim"
    points = clean.points[~cut.is_ground]
    tables = {("ground", side): ground_table(points)}
    if real is None:
        tables, _ = run_in_memory(PARTITION, SETTINGS, tables=tables)
    return Side(CutScan(clean.points, cut.is_ground, cut.height_m), cut, points, tables)


def scored(real, points):
    """Scores and gaps of a simulated scan: the numbers of `fidpipe run`, without the stages that are not needed."""
    sim = prepare(points, real)
    summary = score_pair(SETTINGS, real.tables | sim.tables)
    row = {name: summary[name] for name in SCORES if name in summary}
    row["found"] = summary["n_matched"] / (summary["n_matched"] + summary["n_not_found"])
    both = (real.points, sim.points)
    for side, distance_m in zip(("real", "sim"), nearest_distances(*both), strict=True):
        row[f"covered_{side}_0p1m"] = (distance_m <= 0.1).mean()
    row |= {
        value.name: value.value
        for value in compare_points(*both, SETTINGS.metrics)
        if value.name in SCORES
    }
    row["log_points"] = abs(np.log(len(sim.scan.points) / len(real.scan.points)))
    gaps = [*compare_obstacles(real.scan, sim.scan, SETTINGS.tasks).gaps]
    for task in (compare_ground, compare_occupancy, compare_free_space):
        gaps += task(real.scan, sim.scan, SETTINGS.tasks)
    for gap in gaps:
        name = f"{gap.task}.{gap.measure}"
        row[name if gap.group == ALL else f"{name}.{gap.group}"] = gap.gap
    return row


@dataclass
class Scene:
    """Real scans of one place, and simulated ones to which flaws are added.

    full : (n, 3) points of each scan at full density, to find a car and poles in
    real, simulated : (n, 3) points of each scan; scores are those of the first, odometry takes all
    """

    name: str
    base: str
    full: list
    real: list
    simulated: list

    @cached_property
    def prepared(self):
        return prepare(self.real[0])

    @cached_property
    def path(self):
        return trajectory(self.real)

    @cached_property
    def scans(self):
        scans = []
        for full, points in zip(self.full, self.simulated, strict=True):
            try:
                car = find_car(full)
            except SystemExit:
                car = None
            scans.append(Scan(points, car, find_poles(full)))
        return scans

    def flawed(self, make, amount, flaw):
        """Simulated scans with a flaw."""
        points = []
        for i, scan in enumerate(self.scans):
            names = (self.name, self.base, flaw) if i == 0 else (self.name, self.base, flaw, i)
            points.append(make(amount)(scan, random(*names)))
        return points

    def evaluate(self, points):
        """Scores and gaps of the first scan, and gaps of odometry."""
        row = scored(self.prepared, points[0])
        if len(points) > 1:
            row |= odometry_gaps(self.path, trajectory(points))
        return row

    def conditions(self, which_amounts):
        """Flaw and amount of each condition, and a function that evaluates it."""
        yield NONE, 0.0, lambda: self.evaluate(self.simulated)
        has_cars = all(scan.car is not None for scan in self.scans)
        has_beams = bool(describe_sensor(self.simulated[0]).elevation_deg)
        for flaw, (amounts, make) in FLAWS.items():
            if (flaw.startswith("car") and not has_cars) or ("beams" in flaw and not has_beams):
                continue
            for amount in (amounts[i] for i in which_amounts):

                def evaluate(make=make, amount=amount, flaw=flaw):
                    return self.evaluate(self.flawed(make, amount, flaw))

                yield flaw, float(amount), evaluate


def odometry_gaps(real, sim):
    return {f"odometry.{gap.measure}": gap.gap for gap in compare_trajectories(real, sim)}


def scenes(data, frames):
    """The scenes of all bases."""
    sources = sorted((data / "kitti_twin" / "real").glob("*.bin"))
    for path in (sources[i] for i in frames):
        full = read(path)
        real = full[::EVERY]
        again = remeasured(real, random(path.stem, "base"))
        twin = read(path.parents[1] / "sim" / path.name)[::EVERY]
        yield Scene(path.stem, "good", [full], [real], [again])
        yield Scene(path.stem, "poor", [full], [real], [twin])
    others = {
        "VLP-32C": [read_scan(f"{data}/velodyne_vlp32c/sweeps.pcap#0").points],
        "HDL-32E": [read_scan(str(path)).points for path in (data / "nuscenes").glob("*.bin")],
        "drive": [read(path) for path in sorted((data / "kitti_sequence").glob("*.bin"))],
    }
    for base, scans in others.items():
        full = [points[ranges(points) > 1.5] for points in scans]
        real = [points[::EVERY_OF_DRIVE] for points in full] if base == "drive" else full
        again = [remeasured(points, random(base, i)) for i, points in enumerate(real)]
        yield Scene("0", base, full, real, again)


def real_pairs(data):
    """Two real measurements of one scene: name, kind, and a function that evaluates them."""
    sweeps = [read_scan(f"{data}/velodyne_vlp32c/sweeps.pcap#{i}").points for i in range(5)]
    for i, (first, second) in enumerate(pairwise(sweeps[:4])):
        yield f"parked {i}", "parked", lambda a=first, b=second: scored(prepare(a), b)
    yield (
        "odometry",
        "parked",
        lambda: odometry_gaps(trajectory(sweeps[:4]), trajectory(sweeps[1:])),
    )
    scans = [read(path) for path in sorted((data / "kitti_sequence").glob("*.bin"))]
    rows = np.loadtxt(data / "kitti_sequence" / "poses.tum")
    poses = [(Rotation.from_quat(row[4:8]).as_matrix(), row[1:4]) for row in rows]
    for i in (0, 3, 6):
        r, t = poses[i]
        r_next, t_next = poses[i + 1]
        second = ((scans[i + 1] @ r_next.T + t_next) - t) @ r
        yield (
            f"driving {i}",
            "driving",
            lambda a=scans[i], b=second: scored(prepare(a[::EVERY]), b[::EVERY]),
        )
    halves = [[scan[i::EVERY_OF_DRIVE] for scan in scans] for i in (0, EVERY_OF_DRIVE // 2)]
    yield "odometry", "driving", lambda: odometry_gaps(*map(trajectory, halves))


def measure(args):
    """Evaluates what the CSV file does not have yet."""
    rows = pd.read_csv(args.out).to_dict("records") if args.out.exists() else []
    done = {(str(row["frame"]), row["base"], row["flaw"], row["amount"]) for row in rows}

    def add(key, evaluate):
        if key in done:
            return
        row = dict(zip(("frame", "base", "flaw", "amount"), key, strict=True))
        try:
            row |= evaluate()
        except FidpipeError as error:
            print(*key, error, flush=True)
        rows.append(row)
        pd.DataFrame(rows).to_csv(args.out, index=False)
        print(len(rows), *key, flush=True)

    args.out.parent.mkdir(parents=True, exist_ok=True)
    for name, kind, evaluate in real_pairs(args.data):
        add((name, kind, NONE, 0.0), evaluate)
    for scene in scenes(args.data, args.frames):
        if scene.base in args.bases:
            for flaw, amount, evaluate in scene.conditions(args.amounts):
                add((scene.name, scene.base, flaw, amount), evaluate)


def spearman(a, b):
    """Rank correlation over the conditions that have both; NaN for fewer than ten, or if one is constant."""
    is_known = np.isfinite(a) & np.isfinite(b)
    a, b = rankdata(a[is_known]), rankdata(b[is_known])
    if len(a) < 10 or not np.ptp(a) or not np.ptp(b):
        return np.nan
    return np.corrcoef(a, b)[0, 1]


def correlation(table, score, task):
    """Correlation, its 95 % bootstrap interval over flaws, and the correlations without any one flaw."""
    flaws = table.flaw.unique()
    rows_of = [np.flatnonzero(table.flaw == flaw) for flaw in flaws]
    a = SCORES[score] * table[score].to_numpy()
    b = table[task].to_numpy()
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(1000):
        rows = np.concatenate([rows_of[i] for i in rng.integers(len(flaws), size=len(flaws))])
        drawn.append(spearman(a[rows], b[rows]))
    without = [spearman(np.delete(a, rows), np.delete(b, rows)) for rows in rows_of]
    return spearman(a, b), np.nanquantile(drawn, [0.025, 0.975]), np.array(without)


def predicted(a, b, at):
    """Gap predicted at scores, by isotonic regression on others."""
    return IsotonicRegression(out_of_bounds="clip").fit(a, b).predict(at)


def left_out_error(table, score, task):
    """Mean error of the predicted gap of a flaw that was left out, and that of the mean gap of the others."""
    known = table[np.isfinite(table[score]) & np.isfinite(table[task])]
    a = SCORES[score] * known[score].to_numpy()
    b = known[task].to_numpy()
    errors = []
    of_mean = []
    for flaw in known.flaw.unique():
        is_out = (known.flaw == flaw).to_numpy()
        errors += list(np.abs(predicted(a[~is_out], b[~is_out], a[is_out]) - b[is_out]))
        of_mean += list(np.abs(b[~is_out].mean() - b[is_out]))
    return np.mean(errors), np.mean(of_mean)


def threshold(table, score, task, gap):
    """Worst score whose predicted gap is at most the gap, and its range without any one flaw."""
    known = table[np.isfinite(table[score]) & np.isfinite(table[task])]
    a = SCORES[score] * known[score].to_numpy()
    b = known[task].to_numpy()
    grid = np.linspace(a.min(), a.max(), 2000)

    def reached(rows):
        good = grid[predicted(a[rows], b[rows], grid) <= gap]
        return SCORES[score] * good[-1] if len(good) else np.nan

    each = [reached((known.flaw != flaw).to_numpy()) for flaw in known.flaw.unique()]
    return reached(np.full(len(a), True)), np.nanmin(each), np.nanmax(each)


def print_row(*cells):
    print(f"| {' | '.join(map(str, cells))} |")


def known_tasks(table):
    """The tasks that a base has."""
    return [task for task in TASKS if table[task].notna().any()]


def print_correlations(table, base):
    """A row for each score; then whether the best score of each task stays the best without any one flaw."""
    tasks = known_tasks(table)
    print_row(base, *tasks)
    print_row(*["---"] * (len(tasks) + 1))
    values = {}
    without = {}
    cells = {}
    for score in SCORES:
        for task in tasks:
            values[score, task], (low, high), without[score, task] = correlation(
                table, score, task
            )
            cells[score, task] = f"{values[score, task]:.2f} ({low:.2f} to {high:.2f})"
        print_row(score, *(cells[score, task] for task in tasks))
    print()
    for task in tasks:
        best = max(SCORES, key=lambda score: values[score, task])
        names = np.array([*SCORES])
        left = names[np.nanargmax([without[score, task] for score in SCORES], axis=0)]
        moved = max(
            np.nanmax(np.abs(without[score, task] - values[score, task])) for score in SCORES
        )
        n_same = (left == best).sum()
        print(
            f"{task}: best {best}, also without {n_same} of {len(left)} flaws; no value moves by over {moved:.2f}"
        )
    return cells


def print_thresholds(table, real):
    """The score with the least left-out error of each task, and its values at the gaps of two real measurements."""
    print_row(
        "task",
        "score",
        "left-out error",
        "error of the mean",
        *(f"gap and score, {kind}" for kind in real.index),
    )
    print_row(*["---"] * (4 + len(real)))
    for task in known_tasks(table):
        errors = {score: left_out_error(table, score, task) for score in SCORES}
        best = min(errors, key=lambda score: errors[score][0])
        cells = []
        for gap in real[task]:
            score, low, high = threshold(table, best, task, gap)
            cells.append(f"{gap:.3f}: {score:.3g} ({low:.3g} to {high:.3g})")
        print_row(task, best, *(f"{error:.3f}" for error in errors[best]), *cells)


def print_bases(cells_of):
    """Correlations of all bases next to each other, task by task, from those of each base."""
    for task in TASKS:
        bases = [
            base for base, cells in cells_of.items() if any(name == task for _, name in cells)
        ]
        print_row(task, *bases)
        print_row(*["---"] * (len(bases) + 1))
        for score in SCORES:
            print_row(score, *(cells_of[base][score, task] for base in bases))
        print()


def print_tables(path, bases):
    """All tables of `docs/good-enough.md`."""
    rows = pd.read_csv(path)
    numbers = [*SCORES, *TASKS]
    real = rows[rows.base.isin(("parked", "driving"))].groupby("base")[numbers].mean()
    print_row("two real measurements", *real.index)
    print_row(*["---"] * (1 + len(real)))
    for name in (*TASKS, *SCORES):
        print_row(name, *(f"{value:.3f}" for value in real[name]))
    cells_of = {}
    for base in bases:
        of_base = rows[rows.base == base]
        if of_base.empty:
            continue
        table = of_base.groupby(["flaw", "amount"])[numbers].mean().reset_index()
        without = table[table.flaw == NONE].iloc[0]
        table = table[table.flaw != NONE]
        n = f"{of_base.frame.nunique()} frames, {table.flaw.nunique()} flaws, {len(table)} conditions"
        gaps = [f"{task} {without[task]:.3f}" for task in known_tasks(table)]
        print(f"\n{base}: {n}; without a flaw:", *gaps, "\n")
        cells_of[base] = print_correlations(table, base)
        print()
        print_thresholds(table, real)
    print()
    print_bases(cells_of)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "data", type=Path, help="folder with kitti_twin, kitti_sequence and velodyne_vlp32c"
    )
    parser.add_argument(
        "--out", type=Path, default=Path(".cache/tasks.csv"), help="scores and gaps; resumed"
    )
    parser.add_argument(
        "--frames", type=int, nargs="+", default=[0, 4], help="of kitti_twin, from 0"
    )
    parser.add_argument("--bases", nargs="+", choices=BASES, default=list(BASES))
    parser.add_argument(
        "--amounts", type=int, nargs="+", default=[0, 1, 2], help="of each flaw, from 0"
    )
    parser.add_argument("--print", action="store_true", help="only print the tables")
    arguments = parser.parse_args()
    if not arguments.print:
        measure(arguments)
    print_tables(arguments.out, arguments.bases)
