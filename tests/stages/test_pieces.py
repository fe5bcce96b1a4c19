import numpy as np
import pytest

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.settings import PieceSettings, Settings
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.ground import remove_ground
from fidpipe.stages.linalg.subgraph import connected_points
from fidpipe.stages.literal import literal_pieces as literal
from fidpipe.stages.pieces import CutScan, count_pieces, find_pieces
from scenes import box, grid, road

SETTINGS = PieceSettings()
CAR = box([10, 3, -0.9], [4, 1.8, 1.2], 300, seed=1)
BARE = np.array([[30.0, 30.0, -1.7]])  #: a road of one point, out of the way
HEDGE = box([10, 4.5, -0.9], [12, 0.8, 1.6], 800, seed=2)


def scan(*objects, ground=None):
    """Both kinds of points of a side, the road 1.7 m below the sensor."""
    ground = road(6000) if ground is None else ground
    points = np.vstack([ground, *objects])
    return CutScan(points, np.arange(len(points)) < len(ground), points[:, 2] + 1.7)


def found(real, sim, settings=SETTINGS):
    """The pieces of both sides, and their counts."""
    missing, invented = find_pieces(real, sim, settings)
    return missing, invented, count_pieces(missing, invented)


def test_a_lost_car_next_to_a_hedge_is_one_missing_piece():
    far = box([10, 5.5, -0.9], [12, 0.8, 1.6], 800, seed=2)  # 1.2 m from the car
    real, sim = scan(CAR, far), scan(far, ground=BARE)
    missing, _, counts = found(real, sim)
    assert counts["n_missing_pieces"] == 1
    assert counts["n_invented_pieces"] == 0
    assert missing.labels[missing.labels >= 0].tolist() == [0] * missing.objects.n_points[0]
    n_object_points = len(CAR) + len(far)
    assert counts["missing_pieces_share"] == missing.objects.n_points[0] / n_object_points
    assert missing.objects.n_points[0] > 0.9 * len(CAR)
    assert missing.objects.centroid[0] == pytest.approx([10, 3, -0.9], abs=0.1)
    assert missing.objects.extent[0] == pytest.approx([4, 1.8, 1.2], abs=0.15)
    assert missing.bearing_deg[0] == pytest.approx(np.degrees(np.arctan2(3, 10)), abs=0.5)
    assert missing.height_m[0] == pytest.approx(0.2, abs=0.05)  # its lower face is 1.5 m below the sensor
    assert missing.partner.tolist() == [-1]


def test_what_touches_the_hedge_is_covered_within_reach_and_the_rest_is_the_piece():
    missing, _, counts = found(scan(CAR, HEDGE), scan(HEDGE, ground=BARE))
    assert counts["n_missing_pieces"] == 1
    is_in_piece = missing.labels[6000 : 6000 + len(CAR)] == 0
    assert CAR[is_in_piece, 1].max() < 3.2  # the hedge begins at 4.1 m
    assert CAR[~is_in_piece, 1].max() > 3.8


def test_strips_of_road_that_one_side_cut_away_are_no_pieces():
    strip = grid(np.arange(-5, 5, 0.5), np.arange(-5, 0, 0.5), [-1.4])
    assert found(scan(CAR, strip), scan(CAR))[2] == found(scan(CAR), scan(CAR))[2]
    alone = scan(CAR, strip, ground=BARE)
    assert found(alone, scan(CAR, ground=BARE))[2]["n_missing_pieces"] == 1  # no road there: surface is missing


def test_a_box_that_moved_is_one_missing_and_one_invented_piece_with_the_vector_between_them():
    crate = box([8, 0, -0.5], [1, 1, 1], 200, seed=4)
    post = box([8, 6, 0.5], [0.3, 0.3, 3], 100, seed=5)
    real, sim = scan(crate, post, ground=BARE), scan(crate + [0.5, 2.5, 0.25], post, ground=BARE)
    missing, invented, counts = found(real, sim)
    assert (counts["n_missing_pieces"], counts["n_invented_pieces"]) == (1, 1)
    assert missing.partner.tolist() == invented.partner.tolist() == [0]
    for own in (missing, invented):
        assert own.moved_m[0] == pytest.approx([0.5, 2.5, 0.25], abs=1e-9)


@pytest.mark.parametrize(
    ("shift", "stretch", "is_moved"),
    [
        ([0, 2.9, 0], 1.0, True),
        ([0, 3.0, 0], 1.0, True),
        ([0, 3.1, 0], 1.0, False),  # too far
        ([0, 2.8, 0], 1.45, True),  # half a metre larger at most
        ([0, 2.8, 0], 1.6, False),  # another thing
    ],
)
def test_only_pieces_of_similar_size_nearby_are_one_that_moved(shift, stretch, is_moved):
    crate = grid(*[np.linspace(-0.5, 0.5, 5)] * 3)
    real = scan(crate + [8, 0, 0], ground=BARE)
    sim = scan(crate * stretch + [8, 0, 0] + shift, ground=BARE)
    missing, invented, _ = found(real, sim)
    assert (missing.partner.tolist(), invented.partner.tolist()) == (([0], [0]) if is_moved else ([-1], [-1]))
    assert np.isnan(missing.moved_m[0]).all() != is_moved


def test_of_two_pieces_nearby_the_nearer_one_has_moved():
    crate = grid(*[np.linspace(-0.5, 0.5, 5)] * 3)
    real = scan(crate + [8, 0, 0], ground=BARE)
    sim = scan(crate + [8, 2.8, 0], crate + [8, -2.6, 0], ground=BARE)
    missing, invented, _ = found(real, sim)
    assert missing.moved_m[0] == pytest.approx([0, -2.6, 0])
    assert invented.objects.centroid[missing.partner[0]] == pytest.approx([8, -2.6, 0])
    assert sorted(invented.partner.tolist()) == [-1, 0]


def test_pieces_are_numbered_by_size_and_equal_ones_by_place():
    crate = grid(*[np.linspace(-0.5, 0.5, 4)] * 3)
    missing, _, counts = found(
        scan(crate + [9, 0, 0], crate + [-7, 5, 0], crate[:40] + [0, 9, 0], crate[:9] + [0, -9, 0], ground=BARE),
        scan(crate + [30, 0, 0], ground=BARE),
    )
    assert missing.objects.n_points.tolist() == [64, 64, 40]  # nine points are too few
    assert missing.objects.centroid[:2, 0] == pytest.approx([-7, 9])
    assert counts["missing_pieces_share"] == 168 / 177
    assert missing.bearing_deg == pytest.approx([144.46, 0, 90], abs=1.5)


def test_the_order_of_rows_does_not_change_a_piece_and_a_scan_has_none_against_itself(rng):
    real, sim = scan(CAR, HEDGE, ground=road(50)), scan(CAR[::3] + [0, -2, 0], HEDGE[:100], ground=road(50))
    first = find_pieces(real, sim, SETTINGS)
    assert len(first[0].partner) > 0
    orders = [rng.permutation(len(own.points)) for own in (real, sim)]
    shuffled = [
        CutScan(own.points[order], own.is_ground[order], own.height_m[order])
        for own, order in zip((real, sim), orders, strict=True)
    ]
    for one, other, order in zip(first, find_pieces(*shuffled, SETTINGS), orders, strict=True):
        np.testing.assert_array_equal(one.labels[order], other.labels)
        for name in ("share", "height_m", "partner", "moved_m", "bearing_deg"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        np.testing.assert_array_equal(one.objects.centroid, other.objects.centroid)
    assert set(found(real, real)[2].values()) == {0}


@pytest.mark.parametrize("spread_m", [0.05, 0.4, 1.5, 4.0])
def test_components_are_those_of_all_links(rng, spread_m):
    clumps = [
        place + rng.normal(0, spread_m, (n, 3))
        for place, n in zip(rng.uniform(-6, 6, (15, 3)), [1, 5, 40] * 5, strict=True)
    ]
    for points in (np.vstack(clumps), grid(*[np.arange(6.0) * 0.6] * 3), np.zeros((3, 3)), np.empty((0, 3))):
        labels = connected_points(points, 0.6)
        assert literal.canonical(labels.tolist()) == literal.canonical(literal.components(points, 0.6))


def test_two_dense_clumps_a_link_apart_are_one_component_and_a_little_farther_two(rng):
    clump = rng.uniform(-0.05, 0.05, (400, 3))  # the 16 nearest neighbours are all of the own clump
    clump[0], clump[1] = [0.1, 0, 0], [-0.1, 0, 0]
    for gap_m, n_components in ((0.5999, 1), (0.6001, 2)):
        points = np.vstack([clump, clump + [0.2 + gap_m, 0, 0], clump + [9, 0, 0]])
        assert len(np.unique(connected_points(points, 0.6))) == n_components + 1


def test_a_car_that_is_lost_from_a_real_pair_is_one_missing_piece_more(real_data):
    sides = []
    for side in ("real", "sim"):
        own = clean_scan(read_scan(real_data / "kitti_twin" / side / "000004.bin").points[::4], Settings().input).points
        cut = remove_ground(own, Settings().ground)
        sides.append(CutScan(own, cut.is_ground, cut.height_m))
    real, sim = sides
    low, high = [3.0, -4.0, -2.0], [7.6, -1.6, 0.2]  # a parked car, 6 m ahead on the right
    is_kept = sim.is_ground | ~((sim.points >= low) & (sim.points <= high)).all(axis=1)
    assert 500 < np.count_nonzero(~is_kept) < 700
    without = CutScan(sim.points[is_kept], sim.is_ground[is_kept], sim.height_m[is_kept])
    before, after = (find_pieces(real, own, SETTINGS)[0] for own in (sim, without))
    assert len(after.partner) == len(before.partner) + 1
    centroid = after.objects.centroid
    (car,) = np.flatnonzero(((centroid >= low) & (centroid <= high)).all(axis=1))
    assert after.objects.n_points[car] >= 30
    assert after.objects.range_m[car] == pytest.approx(6, abs=1)
    assert -45 < after.bearing_deg[car] < -15
