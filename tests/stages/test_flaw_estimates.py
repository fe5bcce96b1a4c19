"""Diagnosis of known flaws: each is named with its amount, healthy scans have none, and corrections share the gain."""

import numpy as np
import pytest

from fidpipe.pipeline.diagnose.causes import confirm, name_causes
from fidpipe.pipeline.diagnose.diagnose import is_elsewhere
from fidpipe.schemas.cause_catalogue import CAUSES
from fidpipe.stages.diagnose.evidence import FLAT, UNEVEN, PairScans, Side, estimate, find_unmatched
from fidpipe.stages.diagnose.gain import changes, corrections, off_share, off_shares, shares, surface_distance
from fidpipe.stages.displacement import PARAMETERS, Displacement, fit_displacement
from fidpipe.stages.sensor_description import describe_sensor, sensor_row
from fidpipe.stages.surfels import fit_planes
from runs import some_of

HEALTHY_NOISE_M, HEALTHY_LOSS = 0.01, 0.02


def ranges(points):
    return np.linalg.norm(points, axis=1, keepdims=True)


def noise(std_m):
    return lambda points, rng: points * (1 + rng.normal(0, std_m, (len(points), 1)) / ranges(points))


def lost(share, beyond_m=0.0):
    def lose(points, rng):
        return points[(ranges(points)[:, 0] < beyond_m) | (rng.random(len(points)) >= share)]

    return lose


def lost_grazing(points, rng):
    planes = fit_planes(points, points, 30)
    is_road = points[:, 2] < -1.4
    normal = np.where(is_road[:, None], [0.0, 0.0, 1.0], planes.normal)
    is_grazing = np.abs((normal * points).sum(axis=1)) < np.cos(np.radians(75)) * ranges(points)[:, 0]
    is_lost = is_grazing & (is_road | (planes.scattering < 0.1)) & (rng.random(len(points)) < 0.5)
    return points[~is_lost]


def steps(quantum_m):
    return lambda points, rng: points * np.round(ranges(points) / quantum_m) * quantum_m / ranges(points)


def drops(n):
    def rain(points, rng):
        rows = rng.choice(np.flatnonzero(ranges(points)[:, 0] > 6), n, replace=False)
        wet = points.copy()
        wet[rows] *= rng.uniform(2.5, 5, (n, 1)) / ranges(points[rows])
        return wet

    return rain


def box_cut(points, rng):
    return points[(np.abs(points - [8.0, 0.0, 0.0]) > [4, 3, 5]).any(axis=1)]


def jittered(elevation_deg, azimuth_deg):
    def jitter(points, rng):
        level = np.arcsin(points[:, 2] / ranges(points)[:, 0]) + np.radians(elevation_deg) * rng.normal(
            size=len(points)
        )
        turn = np.arctan2(points[:, 1], points[:, 0]) + np.radians(azimuth_deg) * rng.normal(size=len(points))
        rays = np.column_stack([np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)])
        return ranges(points) * rays

    return jitter


def during_sweep(points, rng):
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    return points - turn[:, None] * [0.8, 0, 0]


#: Flaw, the cause that is right, and its amount.
FLAWS = {
    "forward": (lambda points, rng: points + [0.3, 0, 0], 0.3),
    "height": (lambda points, rng: points - [0, 0, 0.12], -0.12),
    "range scale": (lambda points, rng: points * 1.02, 0.02),
    "range bias": (lambda points, rng: points * (1 + 0.15 / ranges(points)), 0.15),
    "motion forward": (during_sweep, -0.8),
    "range noise": (noise(0.08), 0.07),
    "elevation noise": (jittered(0.1, 0), None),
    "azimuth noise": (jittered(0, 0.03), 0.03),
    "range steps": (steps(0.1), 0.1),
    "lost returns": (lost(0.25), 0.27),
    "lost far returns": (lost(0.5, 25.0), 0.5),
    "lost grazing returns": (lost_grazing, 0.5),
    "maximum range": (lambda points, rng: points[ranges(points)[:, 0] < 40], None),
    "missing pieces": (box_cut, None),
    "clutter": (drops(150), 0.01),
    "azimuth step": (lambda points, rng: points[::2], None),
}


NO_GAIN = ("elevation noise", "azimuth noise")


def on_a_grid(points, rng):
    return np.where(points[:, 2:] > -1.4, np.round(points / 0.4) * 0.4, points)


def bent(points, rng):
    return points + ranges(points) ** 2 * [0, 0.0006, 0]


def wobbling(points, rng):
    return points + ranges(points) * np.sin(3 * np.arctan2(points[:, 1:2], points[:, :1])) * [0, 0, 0.009]


UNKNOWN = {own.__name__: own for own in (on_a_grid, bent, wobbling)}
ALWAYS = ["forward", "motion forward", "range noise", "lost returns", "missing pieces"]


@pytest.fixture(scope="module")
def places(real_data):
    """Two real scans with every fourth return, their road, and their sensors."""
    found = []
    for name in ("000000", "000008"):
        points = (
            np.fromfile(real_data / f"kitti_twin/real/{name}.bin", np.float32).reshape(-1, 4)[::4, :3].astype(float)
        )
        found.append((points, points[:, 2] < -1.4, sensor_row(describe_sensor(points))))
    return found


def simulated(places, flaw=None):
    pairs = []
    for i, (real, is_ground, sensor) in enumerate(places):
        rng = np.random.default_rng(i)
        sim = lost(HEALTHY_LOSS)(noise(HEALTHY_NOISE_M)(real, rng), rng)
        sim = flaw(sim, rng) if flaw else sim
        own = sensor_row(describe_sensor(sim))
        pairs.append(PairScans(Side(real, is_ground, sensor), Side(sim, sim[:, 2] < -1.4, own)))
    return pairs


@pytest.fixture(scope="module")
def healthy(places):
    return [estimate(pair) for pair in simulated(places)]


def test_no_cause_of_a_second_measurement(healthy):
    assert name_causes([pair.amounts for pair in healthy], None, np.arange(2)) == []


@pytest.mark.parametrize("name", some_of([*FLAWS], ALWAYS))
def test_a_flaw_is_named_with_its_amount_and_its_correction_gains(places, healthy, name):
    flaw, amount = FLAWS[name]
    pairs = simulated(places, flaw)
    found = [estimate(pair) for pair in pairs]
    named = name_causes([own.amounts for own in found], [own.amounts for own in healthy], np.arange(2))
    by_name = {own.model.name: own for own in named}
    assert name in by_name
    if amount is not None:
        assert by_name[name].mean == pytest.approx(amount, rel=0.2)
    made = corrections(pairs[0], found[0], {own.model.name: own.mean for own in named}, np.random.default_rng(0))
    found = shares(pairs[0], made, np.random.default_rng(0))
    assert sum(found.by_cause.values()) == pytest.approx(found.before_m - found.after_m)
    assert name in NO_GAIN or max(found.by_cause, key=found.by_cause.get) == name
    assert found.before_m == surface_distance(pairs[0].real.points, pairs[0].sim.points)


@pytest.mark.parametrize("name", some_of([*UNKNOWN], ["on_a_grid"]))
def test_a_flaw_without_a_cause_is_unexplained(places, healthy, name):
    pairs = simulated(places, UNKNOWN[name])
    found = [estimate(pair) for pair in pairs]
    named = name_causes([own.amounts for own in found], [own.amounts for own in healthy], np.arange(2))
    floors_m = [surface_distance(pair.real.points, pair.sim.points) for pair in simulated(places)]

    def correct(amounts):
        rng = np.random.default_rng(0)
        return [
            shares(pair, corrections(pair, own, amounts, rng), rng, floor_m)
            for pair, own, floor_m in zip(pairs, found, floors_m, strict=True)
        ]

    kept, doubtful, left = confirm(named, correct)
    assert kept == []
    assert {own.model.name for own in doubtful} == {own.model.name for own in named}
    assert all(own.after_m == own.before_m > 1.5 * own.floor_m for own in left)


@pytest.mark.parametrize(
    ("flaw", "low", "high"), [(lambda points, rng: points + [0, 0.2, 0], 0.9, 1.0), (wobbling, -2.0, 0.1)]
)
def test_a_displacement_explains_how_two_simulated_scans_differ_unless_another_flaw_feigned_it(places, flaw, low, high):
    pair, floor = simulated(places[:1], flaw)[0], simulated(places[:1])[0]
    amount = {"sideways": 0.2}
    moved = Displacement(np.array([amount.get(name, 0.0) for name in PARAMETERS]))
    found = changes(pair, floor, moved, amount, np.random.default_rng(0))
    assert found.before_m == surface_distance(floor.sim.points, pair.sim.points)
    assert low < found.by_cause["sideways"] / found.before_m <= high


@pytest.mark.parametrize(
    ("flaw", "cause", "amount", "is_left"),
    [
        (None, "sideways", 0.0, False),
        (lambda points, rng: points + [0, 0.3, 0], "sideways", 0.3, False),
        (lost(0.4), "lost returns", 0.4, False),
        *((flaw, "sideways", 0.0, True) for flaw in UNKNOWN.values()),
    ],
)
def test_surface_that_no_correction_brings_back_to_the_floor_even_with_other_rays(
    places, real_data, flaw, cause, amount, is_left
):
    between = np.fromfile(real_data / "kitti_twin/real/000000.bin", np.float32).reshape(-1, 4)[1::4, :3].astype(float)
    others = [(between, between[:, 2] < -1.4, places[0][2])]
    pair, floor = simulated(others, flaw)[0], simulated(places[:1])[0]
    moved = Displacement(np.array([{cause: amount}.get(name, 0.0) for name in PARAMETERS]))
    before, after = off_shares(pair, floor, moved, {cause: amount}, np.random.default_rng(0))
    assert before == off_share(floor.sim.points, pair.sim.points)
    assert is_elsewhere(before, after) == is_left
    assert (before > 0.05) == (is_left or (flaw is not None and cause == "sideways"))


def test_a_displacement_is_undone(places):
    points, is_ground, _ = places[0]
    values = np.array([0.1, -0.2, 0.05, 0.3, -0.4, 0.5, 0.01, 0.02, -0.3, 0.1, 0.05])
    displacement = Displacement(values)
    moved = points + displacement.of(points, is_ground)
    off_m = np.abs(displacement.undo(moved, is_ground) - points).max(axis=1)
    assert np.quantile(off_m, 0.99) < 0.001  # except across the seam of the sweep
    assert len(values) == len(PARAMETERS)


def test_an_object_next_to_a_missing_one_is_moved_but_not_the_road_behind_it():
    rng = np.random.default_rng(0)
    road, box = rng.uniform(-9, 9, (2000, 3)) * [1, 1, 0], rng.uniform(7, 8, (300, 3))
    sensor, is_ground = {"azimuth_step_deg": None}, np.zeros(300, bool)
    seen, hidden = (Side(points, is_ground, sensor) for points in (box, box + [0.8, 0, 0]))
    missing, invented = find_unmatched(seen, hidden)
    assert missing.is_moved.mean() > 0.2
    assert invented.is_moved.mean() > 0.2
    behind = Side(np.vstack([box + [0.8, 0, 0], road]), np.arange(2300) >= 0, sensor)
    missing, invented = find_unmatched(seen, behind)
    assert missing.is_piece.any()
    assert invented.is_piece.any()
    assert not missing.is_moved.any()
    assert not invented.is_moved.any()


def test_moved_pieces_with_missing_and_invented_ones_are_a_bent_world():
    floor = [{"moved pieces": 0.0, "missing pieces": 0.0, "invented pieces": 0.0, UNEVEN: 0.0}] * 4
    car = [{**floor[0], "moved pieces": share} for share in (0.01, 0.02, 0.09, 0.08)]  # Student's t: from 0 to 0.12
    bent = [{**one, "missing pieces": 0.01, "invented pieces": 0.01} for one in car]
    names = [[own.model.name for own in name_causes(pairs, floor, np.arange(4))] for pairs in (car, bent)]
    assert names[0] == ["moved pieces"]
    assert sorted(names[1]) == ["invented pieces", "missing pieces"]


def test_a_loss_over_a_floor_is_a_share_of_what_the_floor_returns(places):
    real, is_ground, sensor = places[0]
    keep = np.random.default_rng(0).random(len(real))
    floor, pair = (
        PairScans(Side(real, is_ground, sensor), Side(real[keep < share], is_ground[keep < share], sensor))
        for share in (0.6, 0.45)
    )
    found = [estimate(own) for own in (floor, pair)]
    named = name_causes([found[1].amounts], [found[0].amounts], np.arange(1))
    (lost,) = [own for own in named if own.model.name == "lost returns"]
    assert lost.mean == pytest.approx(0.25, abs=0.02)
    made = corrections(pair, found[1], {"lost returns": lost.mean}, np.random.default_rng(0))["lost returns"]
    assert len(made.add) / len(real) == pytest.approx(0.15, abs=0.02)


def test_blurred_beams_are_not_named_where_the_world_is_displaced():
    floor = dict.fromkeys((*CAUSES, UNEVEN), 0.0)
    blurred = floor | {"elevation noise": 0.05, "azimuth noise": 0.02}
    found = [
        [own.model.name for own in name_causes([pair], [floor], np.arange(1))]
        for pair in (blurred, blurred | {"pitch": 1})
    ]
    assert found == [["elevation noise", "azimuth noise"], ["pitch"]]


def test_the_scale_of_intensities_is_relative_to_that_of_the_floor():
    floor = dict.fromkeys((*CAUSES, UNEVEN), 0.0) | {"intensity scale": 1 - 0.5}
    (own,) = name_causes([floor | {"intensity scale": 1 - 0.75}] * 2, [floor] * 2, np.arange(2))
    assert own.sentence == "intensities 50 % too high"


def with_balls_or_boxes(real, n):
    """A scan with balls of 2 m ahead of the sensor, and with the faces of the boxes around them in their place."""
    rng, balls, boxes = np.random.default_rng(0), [], []
    for i in range(n):
        centre = np.array([10.0, 6.0 * i - 6, -0.4])
        own = rng.normal(size=(400, 3))
        own = centre + own / np.linalg.norm(own, axis=1, keepdims=True)
        own = own[((own - centre) * own).sum(axis=1) < 0]  # seen from the sensor
        enter = np.sort([(centre - 1) / own, (centre + 1) / own], axis=0)[0].max(axis=1)
        balls.append(own)
        boxes.append(own * enter[:, None])
    scene = real[np.abs(real - [10.0, 0, 0]).max(axis=1) > 10]
    return [np.vstack([scene, *own]) for own in (balls, boxes)]


def test_boxes_instead_of_shapes_are_flat_unless_foliage_is_solid(places):
    real, _, sensor = places[0]
    balls, boxes = (Side(own, own[:, 2] < -1.4, sensor) for own in with_balls_or_boxes(real, 5))
    floor, pair = PairScans(balls, balls), PairScans(balls, boxes)
    found = [estimate(own) for own in (floor, pair)]
    named = {own.model.name: own for own in name_causes([found[1].amounts], [found[0].amounts], np.arange(1))}
    assert FLAT in named
    made = corrections(pair, found[1], {FLAT: named[FLAT].mean}, np.random.default_rng(0))
    gain = shares(pair, made, np.random.default_rng(0))
    assert gain.by_cause[FLAT] > 0.3 * gain.before_m
    for flat, rival in ((0.05, "solid foliage"), (0.2, FLAT)):
        both = found[0].amounts | {FLAT: flat, "solid foliage": 0.3}
        names = {own.model.name for own in name_causes([both], [found[0].amounts], np.arange(1))}
        assert names == {rival}
    melted = found[1].amounts | {FLAT: 0.8}
    assert FLAT not in {own.model.name for own in name_causes([melted], [found[0].amounts], np.arange(1))}


def test_scans_without_common_surface_have_no_estimates(places):
    points, is_ground, sensor = places[0]
    far = points + [0, 0, 500.0]
    assert fit_displacement(points, far, is_ground) is None
    assert estimate(PairScans(*(Side(own, is_ground, sensor) for own in (points, far)))) is None


def test_every_cause_has_words_and_a_tolerance():
    assert list(CAUSES)[: len(PARAMETERS)] == [*PARAMETERS]
    for model in CAUSES.values():
        assert 0 < model.resolution <= model.tolerance
        assert all("{size}" in words for words in model.words)


def test_the_interval_of_a_share_grows_with_its_amount_and_what_is_named_does_not():
    floor, model = [dict.fromkeys((*CAUSES, UNEVEN), 0.0)] * 4, CAUSES["mixed pixels"]
    half_widths = []
    for amount in (0.006, 0.06, 0.6):
        (own,) = name_causes([{**floor[0], model.name: amount}] * 4, floor, np.arange(4))
        assert (own.model.name, own.mean) == (model.name, pytest.approx(amount))
        assert own.mean - own.low == pytest.approx(own.high - own.mean)
        half_widths.append(own.high - own.mean)
    assert half_widths == pytest.approx(
        [np.hypot(0.7 * model.resolution, model.relative * a) for a in (0.006, 0.06, 0.6)]
    )
    assert name_causes([{**floor[0], model.name: 0.9 * model.resolution}] * 4, floor, np.arange(4)) == []
