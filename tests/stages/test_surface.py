"""Displacement, roughness, and missing or invented pieces of surface."""

import numpy as np
import pytest

import literal_pieces as literal
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.settings import PieceSettings, Settings
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.ground import remove_ground
from fidpipe.stages.linalg.subgraph import connected_points
from fidpipe.stages.pieces import CutScan, count_pieces, find_pieces
from fidpipe.stages.statistics.validation import double_validation_metric
from fidpipe.stages.surface import describe_surface, measure_offsets
from scenes import box, grid, moved, rigid, road, street


def wall(rng, n=400, angle_deg=0.0):
    """A wall 8 m ahead, turned about z."""
    points = np.column_stack([np.full(n, 8.0), rng.uniform(-4, 4, n), rng.uniform(-1, 3, n)])
    return moved(points, rigid(angle_deg, [0, 0, 0]))


def offset(real, sim, labels=None):
    return measure_offsets(describe_surface(real), describe_surface(sim), labels)


def test_both_sides_alike_have_no_offset_at_all_and_the_same_roughness(rng):
    scan = street()
    labels = rng.integers(0, 5, len(scan)).astype(np.int32)
    real, sim = describe_surface(scan), describe_surface(scan[::-1])
    for found in (measure_offsets(real, sim), measure_offsets(real, sim, labels)):
        assert np.all(found.shift_m == 0)
        assert np.all(found.distance_m == 0)
    validation = double_validation_metric(real.roughness_m, sim.roughness_m)
    assert (validation.bias, validation.area) == (0, 0)


def test_nothing_depends_on_the_order_of_rows(rng):
    # all distances tie
    grid = np.stack(np.meshgrid(*[np.arange(14.0)] * 3), axis=-1).reshape(-1, 3) + [
        3,
        0,
        0,
    ]
    real = grid
    sim = grid + [0.1, 0.2, 0.3]
    labels = (np.arange(len(grid)) % 7).astype(np.int32)
    of_real, of_sim = rng.permutation(len(real)), rng.permutation(len(sim))
    found = [offset(real, sim, labels), offset(real[of_real], sim[of_sim], labels[of_real])]
    for one, other in zip(*(vars(each).values() for each in found), strict=True):
        np.testing.assert_array_equal(one, other)
    surface, again = describe_surface(real), describe_surface(real[of_real])
    np.testing.assert_array_equal(surface.roughness_m, again.roughness_m)
    np.testing.assert_array_equal(real[surface.rows], real[of_real][again.rows])


def test_points_that_stay_are_drawn_again_when_others_are_lost(rng):
    def drawn(points, seed=0):
        surface = describe_surface(points, seed)
        assert len(surface.normal) == len(surface.roughness_m) == 2000
        return {tuple(point) for point in surface.points[:2000]}

    scan = rng.uniform(-20, 20, (9000, 3))
    kept = scan[rng.random(len(scan)) < 0.8]
    assert drawn(scan) & {tuple(point) for point in kept} <= drawn(kept)
    assert len(drawn(scan) & drawn(scan, seed=1)) < 700


def test_a_line_and_a_single_place_are_no_plane_and_not_rough(rng):
    line = np.outer(np.arange(50.0), [1, 2, 0.5])
    for points in (line, np.ones((30, 3))):
        surface = describe_surface(points)
        assert surface.roughness_m == pytest.approx(np.zeros(len(points)), abs=1e-7)
        assert not surface.is_plane.any()
        assert np.isnan(offset(points, points).distance_m[0])


def test_the_roughness_of_a_noisy_plane_is_its_noise(rng):
    floor = np.column_stack([rng.uniform(0, 20, (1500, 2)), np.zeros(1500)])
    squares = [
        np.mean(
            describe_surface(floor + [0, 0, 1] * rng.normal(0, noise, (1500, 1))).roughness_m
            ** 2
        )
        for noise in (0.0, 0.02, 0.05, 0.1)
    ]
    assert np.sqrt(squares) == pytest.approx([0, 0.02, 0.05, 0.1], rel=0.05, abs=1e-7)


@pytest.mark.exhaustive
def test_two_halves_of_a_real_scan_lie_as_far_apart_as_they_are_moved(real_data, rng):
    for name in ("000000", "000006"):
        scan = clean_scan(
            read_scan(real_data / f"kitti_twin/real/{name}.bin").points, Settings().input
        ).points
        scan = scan[~remove_ground(scan, Settings().ground).is_ground]
        half = rng.random(len(scan)) < 0.5
        for shift in ([0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, -0.2]):
            assert offset(scan[half], scan[~half] + shift).shift_m[0] == pytest.approx(
                shift, abs=0.02
            )


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
    # no road there: surface is missing
    assert found(alone, scan(CAR, ground=BARE))[2]["n_missing_pieces"] == 1


def test_a_box_that_moved_is_one_missing_and_one_invented_piece_with_the_vector_between_them():
    crate = box([8, 0, -0.5], [1, 1, 1], 200, seed=4)
    post = box([8, 6, 0.5], [0.3, 0.3, 3], 100, seed=5)
    real, sim = (
        scan(crate, post, ground=BARE),
        scan(crate + [0.5, 2.5, 0.25], post, ground=BARE),
    )
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
    assert (missing.partner.tolist(), invented.partner.tolist()) == (
        ([0], [0]) if is_moved else ([-1], [-1])
    )
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
        scan(
            crate + [9, 0, 0],
            crate + [-7, 5, 0],
            crate[:40] + [0, 9, 0],
            crate[:9] + [0, -9, 0],
            ground=BARE,
        ),
        scan(crate + [30, 0, 0], ground=BARE),
    )
    assert missing.objects.n_points.tolist() == [64, 64, 40]  # nine points are too few
    assert missing.objects.centroid[:2, 0] == pytest.approx([-7, 9])
    assert counts["missing_pieces_share"] == 168 / 177
    assert missing.bearing_deg == pytest.approx([144.46, 0, 90], abs=1.5)


def test_the_order_of_rows_does_not_change_a_piece_and_a_scan_has_none_against_itself(rng):
    real, sim = (
        scan(CAR, HEDGE, ground=road(50)),
        scan(CAR[::3] + [0, -2, 0], HEDGE[:100], ground=road(50)),
    )
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
    for points in (
        np.vstack(clumps),
        grid(*[np.arange(6.0) * 0.6] * 3),
        np.zeros((3, 3)),
        np.empty((0, 3)),
    ):
        labels = connected_points(points, 0.6)
        assert literal.canonical(labels.tolist()) == literal.canonical(
            literal.components(points, 0.6)
        )


def test_two_dense_clumps_a_link_apart_are_one_component_and_a_little_farther_two(rng):
    # the 16 nearest neighbours are all of the own clump
    clump = rng.uniform(-0.05, 0.05, (400, 3))
    clump[0] = [0.1, 0, 0]
    clump[1] = [-0.1, 0, 0]
    for gap_m, n_components in ((0.5999, 1), (0.6001, 2)):
        points = np.vstack([clump, clump + [0.2 + gap_m, 0, 0], clump + [9, 0, 0]])
        assert len(np.unique(connected_points(points, 0.6))) == n_components + 1
