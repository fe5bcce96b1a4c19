"""Baseline metrics by hand, and where they cannot be computed."""

import math

import numpy as np
import pytest
import scipy.linalg
from scipy import sparse
from scipy.optimize import linprog
from scipy.spatial.distance import cdist

import literal_baselines as literal
from fidpipe.schemas.metric_catalogue import BASELINE_NAMES
from fidpipe.schemas.settings import MetricsSettings, SelectionSettings
from fidpipe.stages import baselines
from fidpipe.stages.baselines import (
    chamfer,
    compare_points,
    dcd,
    earth_movers,
    f_score,
    hausdorff,
    histogram,
    nvs,
)
from fidpipe.stages.linalg.heat import heat_row_sums
from fidpipe.stages.linalg.laplacian import normalised_laplacian
from fidpipe.stages.selection import Selection, select_nodes
from scenes import box, moved, rigid, subgraph

ALL = MetricsSettings(baselines=BASELINE_NAMES)


def value(baseline, real, sim, **settings):
    """The only value of a baseline metric of two point sets."""
    (found,) = baseline(real, sim, MetricsSettings(**settings))
    return found.value


def compare(real, sim, settings=ALL):
    graphs = subgraph(real), subgraph(sim)
    nodes = select_nodes(*graphs, SelectionSettings())
    values = compare_points(real, sim, settings, nodes=nodes)
    return {baseline.name: baseline for baseline in values}


@pytest.fixture
def car():
    return box([5, 3, 0], [4, 2, 1.5], 120)


def test_histograms_by_hand():
    # distances 1, 1, 2 against 1: shares of the lower and the upper half of the range
    three, two = (
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]),
        np.array([[0.0, 0, 0], [7, 0, 0]]),
    )
    # 1/2 lies in the upper half
    assert value(histogram, three, two, histogram_bins=2, histogram_order=1) == pytest.approx(0)
    assert value(histogram, three, two, histogram_bins=3, histogram_order=1) == pytest.approx(
        2 / 3 + 2 / 3
    )


def test_histograms_see_neither_place_nor_turn_nor_size(car):
    assert value(
        histogram, car, 2 * moved(car, rigid(40, [3, 1, 2])), histogram_bins=20
    ) == pytest.approx(0, abs=1e-12)


def test_no_order_of_rows_changes_a_histogram_above_its_sample_or_dcd_at_ties(rng):
    real = rng.normal(0, 1, (400, 3))
    sim = np.round(rng.normal(0, 1, (500, 3)))
    # a grid: many points are equally near
    real[:200] = np.round(real[:200])
    sim = np.unique(sim, axis=0)
    real = np.unique(real, axis=0)
    turned = rng.permutation(len(real)), rng.permutation(len(sim))
    values = [
        (
            value(histogram, a, b, histogram_points=60, histogram_bins=20),
            value(dcd, a, b, dcd_alpha=1),
        )
        for a, b in ((real, sim), (real[turned[0]], sim[turned[1]]))
    ]
    assert values[0] == pytest.approx(values[1], abs=1e-12)
    assert values[0][1] == pytest.approx(literal.dcd(real, sim, 1.0), abs=1e-12)


def test_a_shift_moves_the_distances_and_not_the_shapes(car):
    values = compare(car, car + [0, 0, 0.3])
    for name in ("emd_mean_m", "emd_kept_mean_m"):
        assert values[name].value == pytest.approx(0.3), name
    for name in ("emd_centred_mean_m", "histogram"):
        assert values[name].value == pytest.approx(0, abs=1e-5), name
    assert values["hausdorff_m"].value == pytest.approx(0.3, abs=0.15)


def test_unequal_sizes_are_said_where_dcd_was_cut(car):
    values = compare(car, np.vstack([car[:60], car[:20] + 0.01]))
    assert values["dcd"].value is not None
    assert all(number in values["dcd"].reason for number in ("120", "80", "200"))


def test_what_cannot_be_computed_is_null_with_its_reason():
    two = np.array([[0.0, 0, 0], [0, 0, 1]])
    values = compare(two, two[:1])
    reasons = {
        name: baseline.reason for name, baseline in values.items() if baseline.value is None
    }
    assert reasons.keys() == {"histogram"}
    assert all(reasons.values())
    single = compare(two[:1], two)
    assert single["dcd"].value is None and single["dcd"].reason


def earth_moved(real, sim, nodes, **settings):
    every = np.arange(nodes)
    selection = Selection(every, every, np.ones(nodes), np.ones(nodes))
    wanted = MetricsSettings(baselines=("emd",), **settings)
    return compare_points(real, sim, wanted, nodes=selection)


def test_earth_is_moved_between_all_points_and_between_the_aligned_nodes_alone(car):
    # the simulated side also has a tenth of its points 12 m above: these are no nodes of the alignment
    above = car[:12] + [1, 0, 12]
    exact, kept, centred = earth_moved(car, np.vstack([car + [1, 0, 0], above]), 50)
    assert (kept.name, kept.value) == ("emd_kept_mean_m", pytest.approx(1))
    assert (centred.name, centred.value) == ("emd_centred_mean_m", pytest.approx(0, abs=1e-12))
    # the share that must rise 12 m, less the car's own height
    assert exact.name == "emd_mean_m"
    assert 12 / 132 * (12 - 1.5) < exact.value < 1 + 12 / 132 * (12 + 1.5)


def test_objects_too_large_to_move_all_earth_are_null_with_their_size(car):
    exact, kept, _ = earth_moved(car, car[:90], 50, emd_max_points=119)
    assert exact.value is None and "metrics.emd_max_points" in exact.reason
    assert kept.value is not None
    assert earth_moved(car, car[:90], 50, emd_max_points=120)[0].value > 0


def test_a_transport_that_the_solver_could_not_finish_is_null_with_its_reason(car, monkeypatch):
    monkeypatch.setattr(baselines, "_MAX_PIVOTS", 5)
    exact, kept, _ = earth_moved(car, car[:90] + [1, 0, 0], 50)
    assert exact.value is None and "simplex" in exact.reason
    assert kept.value == pytest.approx(1)


REAL = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
SIM = np.array([[0.0, 0, 1], [1, 0, 3]])
# nearest: real -> sim 1, sqrt 2, sqrt 5 (all to the first); sim -> real 1, 3


def test_chamfer_by_hand():
    mean_m, squared_m2, one_way_sum_m = [baseline.value for baseline in chamfer(REAL, SIM, ALL)]
    assert mean_m == pytest.approx((1 + math.sqrt(2) + math.sqrt(5)) / 3 + (1 + 3) / 2)
    assert squared_m2 == pytest.approx((1 + 2 + 5) / 3 + (1 + 9) / 2)
    assert one_way_sum_m == pytest.approx(1 + math.sqrt(2) + math.sqrt(5))


def test_hausdorff_by_hand_is_the_worst_point_of_either_side():
    assert value(hausdorff, REAL, SIM) == 3
    assert value(hausdorff, SIM, REAL) == 3


def test_f_score_by_hand():
    # within 1.2 m: one of three real points, one of two simulated ones
    assert value(f_score, REAL, SIM, f_score_distance_m=1.2) == pytest.approx(
        2 * (1 / 3) * (1 / 2) / (1 / 3 + 1 / 2)
    )
    assert value(f_score, REAL, SIM, f_score_distance_m=0.9) == 0
    assert value(f_score, REAL, SIM, f_score_distance_m=10) == 1


def test_a_point_at_the_very_distance_is_not_found():
    assert value(f_score, REAL[:1], SIM[:1], f_score_distance_m=1.0) == 0


def test_dcd_of_equal_sizes_by_hand():
    # diagonal of the real box 1, so alpha is per square metre; both simulated points are nearest to the first real one
    real, sim = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[-0.1, 0, 0], [0, 0.2, 0]])
    from_real = (
        1 - math.exp(-10 * 0.01) + 1 - math.exp(-10 * 1.04)
    ) / 2  # to the first and to the second one
    from_sim = (1 - 0.5 * math.exp(-10 * 0.01) + 1 - 0.5 * math.exp(-10 * 0.04)) / 2
    (found,) = dcd(real, sim, MetricsSettings(dcd_alpha=10))
    assert (found.value, found.reason) == (pytest.approx((from_real + from_sim) / 2), None)


def test_dcd_of_unequal_sizes_cuts_the_weights_at_one_and_counts_them():
    # three real points for one simulated one: from the real side each weight is (3 / 1) / 3 = 1, from the simulated
    # side (1 / 3) / 1; with a second simulated point far off, its first neighbour weighs (3 / 2) / 3, the other none
    real = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]])
    (found,) = dcd(real, np.array([[0.5, 0, 0]]), MetricsSettings(dcd_alpha=1))
    from_real = np.mean([1 - math.exp(-0.25), 1 - math.exp(-0.25), 0])
    assert (found.value, found.reason) == (pytest.approx((from_real + 1 - 1 / 3) / 2), None)
    # two of three real points at one simulated point, the third alone at the other: weights 3/4, 3/4 and 3/2, cut
    (found,) = dcd(real, np.array([[0.25, 0, 0], [1, 0, 0]]), MetricsSettings(dcd_alpha=1))
    from_real = np.mean([1 - 0.75 * math.exp(-0.0625), 1 - 0.75 * math.exp(-0.0625), 0])
    from_sim = np.mean([1 - 2 / 3 * math.exp(-0.0625), 1 - 2 / 3])
    assert found.value == pytest.approx((from_real + from_sim) / 2)
    assert "1 of 5" in found.reason


def transport(a, b):
    """The definition itself: the least cost of all flows that empty every point of a and fill every point of b."""
    n, m = len(a), len(b)
    leaves, reaches = np.kron(np.eye(n), np.ones(m)), np.kron(np.ones(n), np.eye(m))
    shares = np.concatenate([np.full(n, 1 / n), np.full(m, 1 / m)])
    return linprog(cdist(a, b).ravel(), A_eq=np.vstack([leaves, reaches]), b_eq=shares).fun


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 5), (3, 7), (8, 6), (12, 12), (13, 29)])
def test_earth_movers_agrees_with_a_linear_programme(rng, n, m):
    a, b = rng.normal(0, 1, (n, 3)), rng.normal(1, 2, (m, 3))
    assert earth_movers(a, b) == pytest.approx(transport(a, b), abs=1e-9)


def random_laplacian(rng, n, density=0.3):
    weights = np.triu(rng.uniform(0.1, 1, (n, n)) * (rng.random((n, n)) < density), 1)
    return normalised_laplacian(sparse.csr_matrix(weights + weights.T))


@pytest.mark.parametrize("t", [0.1, 1.0, 7.0, 100.0])
def test_the_heat_row_sums_agree_with_the_dense_exponential(rng, t):
    pieces = random_laplacian(rng, 60), sparse.csr_matrix((1, 1))  # and an isolated node
    L = sparse.block_diag(pieces, format="csr")
    np.testing.assert_allclose(
        heat_row_sums(L, t), scipy.linalg.expm(-t * L.toarray()).sum(axis=1), atol=1e-12
    )


def test_scores_of_synthesis_papers_on_two_scans_worked_out_by_hand():
    real = np.array([[10.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    sim = np.array([[10.0, 0.0, 0.0]])  # one ray dropped: it counts with its whole range
    n_pixels = 66 * 1030
    values = {baseline.name: baseline.value for baseline in nvs(real, sim)}
    assert values["nvs_depth_rmse_m"] == pytest.approx(np.sqrt(20.0**2 / n_pixels), rel=1e-6)
    assert values["nvs_depth_medae_m"] == 0.0
    assert values["nvs_depth_psnr_db"] == pytest.approx(
        10 * np.log10(80.0**2 * n_pixels / 20.0**2), rel=1e-6
    )
    # of directions of pixels
    assert values["nvs_chamfer_m2"] == pytest.approx((10.0**2 + 20.0**2) / 2, rel=1e-2)
    assert values["nvs_f_score_0p05m2"] == pytest.approx(2 * 1.0 * 0.5 / 1.5)


def test_scores_of_synthesis_papers_have_reasons_where_the_image_is_empty():
    far = np.array([[90.0, 0.0, 0.0]])
    reasons = {baseline.name: baseline.reason for baseline in nvs(far, far)}
    assert all(
        reasons[name] for name in ("nvs_depth_psnr_db", "nvs_chamfer_m2", "nvs_f_score_0p05m2")
    )
