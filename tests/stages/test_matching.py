import tracemalloc

import numpy as np
import pytest

from fidpipe.schemas.settings import MatchingSettings
from fidpipe.stages.matching import match_communities


def pairs(matching):
    return list(zip(matching.real_ids.tolist(), matching.sim_ids.tolist(), matching.distance_m.tolist(), strict=True))


def test_greedy_takes_what_comes_first_and_optimal_what_is_best():
    # Real 0 is near sim 0, but real 1 has no other partner.
    real, sim = np.array([[0.0, 0, 0], [3, 0, 0]]), np.array([[1.0, 0, 0], [-4, 0, 0]])
    assert [pair[:2] for pair in pairs(match_communities(real, sim, MatchingSettings()))] == [(0, 0)]
    optimal = match_communities(real, sim, MatchingSettings(method="optimal"))
    assert [pair[:2] for pair in pairs(optimal)] == [(0, 1), (1, 0)]


def test_a_centroid_at_exactly_delta_does_not_match():
    matching = match_communities(np.zeros((1, 3)), np.array([[5.0, 0, 0]]), MatchingSettings(delta_m=5))
    assert (matching.missing.tolist(), matching.hallucinated.tolist(), matching.match_rate) == ([0], [0], 0.0)


def test_of_equally_near_centroids_the_smaller_id_is_taken():
    matching = match_communities(np.zeros((1, 3)), np.array([[0.0, 1, 0], [1, 0, 0]]), MatchingSettings())
    assert matching.sim_ids.tolist() == [0]


def test_the_match_rate_counts_the_side_that_has_more():
    matching = match_communities(np.zeros((1, 3)), np.array([[1.0, 0, 0], [50, 0, 0], [70, 0, 0]]), MatchingSettings())
    assert matching.match_rate == pytest.approx(1 / 3)


def test_thousands_of_objects_are_matched_one_row_at_a_time():
    places = np.random.default_rng(0).uniform(0, 1e4, (4000, 3))
    tracemalloc.start()
    matching = match_communities(places, places[::-1], MatchingSettings())
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (matching.sim_ids == np.arange(4000)[::-1][matching.real_ids]).all()
    assert peak_bytes < 8 * 4000**2 / 10  # no matrix of all distances
