import sys

import numpy as np
import pytest

from fidpipe.schemas.metric_catalogue import BASELINE_NAMES
from fidpipe.schemas.settings import MetricsSettings, SelectionSettings
from fidpipe.stages.baselines import compare_objects, compare_points, emd
from fidpipe.stages.baselines.dcd import density_aware_chamfer
from fidpipe.stages.baselines.histogram import histogram_distance
from fidpipe.stages.baselines.icp import register
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


def test_histograms_by_hand():
    # distances 1, 1, 2 against 1: shares of the lower and the upper half of the range
    three, two = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0.0, 0, 0], [7, 0, 0]])
    assert histogram_distance(three, two, 10, 2, 1) == pytest.approx(0)  # 1/2 lies in the upper half
    assert histogram_distance(three, two, 10, 3, 1) == pytest.approx(2 / 3 + 2 / 3)


def test_histograms_see_neither_place_nor_turn_nor_size(car):
    assert histogram_distance(car, 2 * moved(car, rigid(40, [3, 1, 2])), 500, 20, 2) == pytest.approx(0, abs=1e-12)


def test_large_sides_are_sampled_alike(rng):
    points = rng.normal(0, 1, (300, 3))
    assert histogram_distance(points, points.copy(), 50, 20, 2) == 0
    assert 0 < histogram_distance(points, points[:200], 50, 20, 2) < 0.3


def test_icp_undoes_a_small_motion(car):
    result = register(car, moved(car - [5, 3, 0], rigid(3, [0.1, -0.05, 0.1])) + [5, 3, 0], 1.0)
    assert result.has_converged
    assert result.fitness == 1
    assert result.rmse_m == pytest.approx(0, abs=1e-5)


def test_icp_fitness_is_the_share_of_simulated_points_that_are_near(car):
    far = np.array([[5.0, 60, 0]]) + np.random.default_rng(0).normal(0, 1, (40, 3))
    result = register(car, np.vstack([car, far]), 0.5)
    assert result.fitness == pytest.approx(120 / 160)
    assert result.rmse_m == pytest.approx(0, abs=1e-9)
    nowhere = register(car, far, 0.5)
    assert (nowhere.fitness, nowhere.rmse_m) == (0, None)


def test_no_order_of_rows_changes_a_histogram_above_its_sample_or_dcd_at_ties(rng):
    real, sim = rng.normal(0, 1, (400, 3)), np.round(rng.normal(0, 1, (500, 3)))
    real[:200], sim = np.round(real[:200]), np.unique(sim, axis=0)  # a grid: many points are equally near
    real = np.unique(real, axis=0)
    turned = rng.permutation(len(real)), rng.permutation(len(sim))
    values = [
        (histogram_distance(a, b, 60, 20, 2), density_aware_chamfer(a, b, 1.0).dcd)
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
    assert {name for name, baseline in values.items() if baseline.value is None} == {
        "histogram",
        "icp_fitness",
        "icp_rmse_m",
        "r_h",
    }
    assert all(baseline.reason for baseline in values.values() if baseline.value is None)
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
    monkeypatch.setattr(emd, "_MAX_PIVOTS", 5)
    exact, kept, _ = earth_moved(car, car[:90] + [1, 0, 0], 50)
    assert (exact.value, exact.reason) == (None, "the network simplex ended without the optimum")
    assert kept.value == pytest.approx(1)
