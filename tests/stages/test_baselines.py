"""Baseline metrics by hand, and where they cannot be computed."""

import sys

import numpy as np
import pytest
import scipy.linalg
from scipy import sparse
from scipy.optimize import linprog
from scipy.spatial.distance import cdist

from fidpipe.schemas.metric_catalogue import BASELINE_NAMES
from fidpipe.schemas.settings import MetricsSettings, SelectionSettings
from fidpipe.stages import baselines
from fidpipe.stages.baselines import (
    compare_objects,
    compare_points,
    density_aware_chamfer,
    diffusion_change,
    earth_movers,
    f_score,
    histogram_distance,
    icp,
)
from fidpipe.stages.linalg.heat import heat_row_sums
from fidpipe.stages.linalg.laplacian import normalised_laplacian
from fidpipe.stages.literal import literal_baselines as literal
from fidpipe.stages.selection import Selection, select_nodes
from scenes import box, moved, rigid, subgraph

ALL = MetricsSettings(baselines=BASELINE_NAMES)


def compare(real, sim, settings=ALL):
    graphs = subgraph(real), subgraph(sim)
    values = compare_objects(*graphs, select_nodes(*graphs, SelectionSettings()), 1.0, settings)
    return {baseline.name: baseline for baseline in values}


@pytest.fixture
def car():
    return box([5, 3, 0], [4, 2, 1.5], 120)


def test_icp_undoes_a_small_motion(car):
    fitness, rmse_m = icp(car, moved(car - [5, 3, 0], rigid(3, [0.1, -0.05, 0.1])) + [5, 3, 0], ALL)
    assert (fitness.value, fitness.reason, rmse_m.reason) == (1, None, None)
    assert rmse_m.value == pytest.approx(0, abs=1e-5)


def test_icp_fitness_is_the_share_of_simulated_points_that_are_near(car):
    far = np.array([[5.0, 60, 0]]) + np.random.default_rng(0).normal(0, 1, (40, 3))
    near = ALL.model_copy(update={"icp_distance_m": 0.5})
    fitness, rmse_m = icp(car, np.vstack([car, far]), near)
    assert fitness.value == pytest.approx(120 / 160)
    assert rmse_m.value == pytest.approx(0, abs=1e-9)
    fitness, rmse_m = icp(car, far, near)
    assert (fitness.value, rmse_m.value, rmse_m.reason) == (0, None, "no points within 0.5 m of each other")


def test_no_order_of_rows_changes_a_histogram_above_its_sample_or_dcd_at_ties(rng):
    real, sim = rng.normal(0, 1, (400, 3)), np.round(rng.normal(0, 1, (500, 3)))
    real[:200], sim = np.round(real[:200]), np.unique(sim, axis=0)  # a grid: many points are equally near
    real = np.unique(real, axis=0)
    turned = rng.permutation(len(real)), rng.permutation(len(sim))
    values = [
        (histogram_distance(a, b, 60, 20, 2), density_aware_chamfer(a, b, 1.0)[0])
        for a, b in ((real, sim), (real[turned[0]], sim[turned[1]]))
    ]
    assert values[0] == pytest.approx(values[1], abs=1e-12)
    assert values[0][1] == pytest.approx(literal.dcd(real, sim, 1.0), abs=1e-12)


def test_a_shift_moves_the_distances_and_not_the_shapes(car):
    values = compare(car, car + [0, 0, 0.3])
    for name in ("emd_mean_m", "emd_kept_mean_m"):
        assert values[name].value == pytest.approx(0.3), name
    for name in ("emd_centred_mean_m", "histogram", "icp_rmse_m", "netlsd", "r_h"):
        assert values[name].value == pytest.approx(0, abs=1e-5), name
    assert values["hausdorff_m"].value == pytest.approx(0.3, abs=0.15)


def test_unequal_sizes_are_said_where_dcd_was_cut(car):
    values = compare(car, np.vstack([car[:60], car[:20] + 0.01]))
    assert values["dcd"].value is not None
    assert values["dcd"].reason.startswith("120 real and 80 simulated points: ")
    assert values["dcd"].reason.endswith("of 200 count weights cut at 1")


def test_what_cannot_be_computed_is_null_with_its_reason():
    two = np.array([[0.0, 0, 0], [0, 0, 1]])
    values = compare(two, two[:1])
    reasons = {name: baseline.reason for name, baseline in values.items() if baseline.value is None}
    assert reasons.keys() == {"histogram", "icp_fitness", "icp_rmse_m", "r_h"}
    assert all(reasons.values())
    assert values["r_h"].reason == "1 aligned nodes, at least 3 are needed"
    single = compare(two[:1], two)
    assert (single["dcd"].value, single["dcd"].reason) == (None, "the real points have no extent to scale by")


def test_objects_too_large_for_their_spectrum_are_left_out(car):
    values = compare(car, car, ALL.model_copy(update={"heat_max_nodes": 100}))
    assert (values["netlsd"].value, values["netlsd"].reason) == (None, "120 points, metrics.heat_max_nodes allows 100")


def test_without_the_library_icp_is_null_with_its_reason(car, monkeypatch):
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    values = compare_points(car, car, MetricsSettings(baselines=("icp",)))
    assert [(baseline.value, baseline.reason) for baseline in values] == [
        (None, 'small_gicp is not installed; pip install "fidpipe[icp]"')
    ] * 2


def test_two_point_sets_have_the_baselines_that_need_no_objects(car):
    names = [baseline.name for baseline in compare_points(car, car, ALL)]
    assert not {"emd_mean_m", "netlsd", "r_h"} & set(names)
    assert len(names) == 10


def earth_moved(real, sim, nodes, **settings):
    every = np.arange(nodes)
    selection = Selection(every, every, np.ones(nodes), np.ones(nodes))
    wanted = MetricsSettings(baselines=("emd",), **settings)
    return compare_objects(subgraph(real), subgraph(sim), selection, 1.0, wanted)


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
    assert (exact.value, exact.reason) == (None, "120 points, metrics.emd_max_points allows 119")
    assert kept.value is not None
    assert earth_moved(car, car[:90], 50, emd_max_points=120)[0].value > 0


def test_a_transport_that_the_solver_could_not_finish_is_null_with_its_reason(car, monkeypatch):
    monkeypatch.setattr(baselines, "_MAX_PIVOTS", 5)
    exact, kept, _ = earth_moved(car, car[:90] + [1, 0, 0], 50)
    assert (exact.value, exact.reason) == (None, "the network simplex ended without the optimum")
    assert kept.value == pytest.approx(1)


def test_a_point_at_the_very_distance_is_not_found():
    assert f_score(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), 1.0) == 0


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


def test_earth_movers_of_a_set_with_itself_is_nothing_whatever_the_order_and_however_often_each_point_stands(rng):
    a = rng.normal(0, 1, (90, 3))
    assert earth_movers(a, a) == 0
    assert earth_movers(a, a[::-1].copy()) == 0
    assert earth_movers(a, np.vstack([a, a, a])) == 0
    assert earth_movers(np.ones((4, 3)), np.ones((7, 3))) == 0


def test_earth_movers_of_a_shift_is_its_length_and_of_a_common_motion_the_same(rng):
    a, b = rng.normal(0, 1, (60, 3)), rng.normal(1, 2, (41, 3))
    assert earth_movers(a, a + [2, 3, 6]) == pytest.approx(7, abs=1e-9)
    turn = rigid(40, [500_000.0, 4_000_000.0, 3.0])
    assert earth_movers(moved(a, turn), moved(b, turn)) == pytest.approx(earth_movers(a, b), abs=1e-8)
    assert earth_movers(b, a) == pytest.approx(earth_movers(a, b), abs=1e-12)


def random_laplacian(rng, n, density=0.3):
    weights = np.triu(rng.uniform(0.1, 1, (n, n)) * (rng.random((n, n)) < density), 1)
    return normalised_laplacian(sparse.csr_matrix(weights + weights.T))


@pytest.mark.parametrize("t", [0.1, 1.0, 7.0, 100.0])
def test_the_heat_row_sums_agree_with_the_dense_exponential(rng, t):
    pieces = random_laplacian(rng, 60), sparse.csr_matrix((1, 1))  # and an isolated node
    L = sparse.block_diag(pieces, format="csr")
    np.testing.assert_allclose(heat_row_sums(L, t), scipy.linalg.expm(-t * L.toarray()).sum(axis=1), atol=1e-12)


def test_the_diffusion_change_of_a_small_change_in_a_short_time_is_nearly_one():
    # d exp(-tL) = -t dL + O(t^2)
    a, b = (
        normalised_laplacian(sparse.diags_array([w, w], offsets=[1, -1]).tocsr())
        for w in (np.ones(5), 1 + 0.1 * np.arange(5))
    )
    assert diffusion_change(a, b, 1e-4, 1e-5) == pytest.approx(1, abs=1e-3)
