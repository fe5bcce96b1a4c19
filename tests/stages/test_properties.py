"""Properties of any small cloud: of few distinct coordinates, on a line, doubled, huge, tiny, at two scales."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bounds import KEEP_ALL, evaluated, faults_of
from fidpipe.schemas.columns import FARTHEST_M
from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.settings import MetricsSettings, load
from fidpipe.stages.baselines import compare_points
from fidpipe.stages.coverage import nearest_distances
from fidpipe.stages.graph import graph_of
from fidpipe.stages.metrics import chamfer_density_aware, score_object
from fidpipe.stages.selection import select_nodes
from runs import some_of

SCALES = tuple(
    10.0**e
    for e in (-310, -200, -162, -155, -60, -45, -40, -20, -8, -3, 0, 0, 0, 0, 1, 3, 6, 8)
)
EVERYTHING = KEEP_ALL | {"metrics": {"baselines": "all"}, "stability": {"seeds": 2}}
REFERENCE = {"preset": "reference"}
SETTINGS = (
    EVERYTHING,
    REFERENCE | EVERYTHING,
    {"input": KEEP_ALL["input"]},
    {"input": KEEP_ALL["input"], "ground": {"loss": "total", "shared": True}},
    KEEP_ALL | {"graph": {"edges": "intersection", "k": 2, "tau_m": 0.5}},
    KEEP_ALL | {"graph": {"k": 1, "tau_m": 0}},
    KEEP_ALL | {"communities": {"backend": "python-louvain"}},
    KEEP_ALL | {"matching": {"method": "optimal", "delta_m": 1e-3}},
    KEEP_ALL | {"selection": {"t": 100}},
)
#: The same examples in every run: a failure is one of the code, and does not come and go.
PROFILE = settings(max_examples=40, deadline=None, database=None, derandomize=True)
BOTH_WAYS = (
    "chamfer_mean_m",
    "chamfer_squared_m2",
    "hausdorff_m",
    "f_score",
    "histogram",
)


@st.composite
def clouds(draw, fewest=1, most=60, scales=SCALES):
    """Points whose coordinates are from a pool of few values; some doubled, lined up, flat, jittered, at two scales."""
    n = draw(st.integers(fewest, most))
    values = st.one_of(st.integers(-5, 5).map(float), st.floats(-1, 1, width=32))
    pool = np.array(draw(st.lists(values, min_size=3, max_size=8, unique=True)))
    points = pool[
        np.array(
            draw(
                st.lists(
                    st.tuples(*[st.integers(0, len(pool) - 1)] * 3), min_size=n, max_size=n
                )
            )
        )
    ]
    shape = draw(
        st.sampled_from(
            ("as it is", "line", "plane", "jitter", "two scales", "next to each other")
        )
    )
    if shape == "line":
        points = np.outer(np.arange(n), points[0])
    elif shape == "plane":
        points[:, draw(st.integers(0, 2))] = 1.0
    elif shape == "jitter":
        points = points + np.random.default_rng(n).normal(
            0, draw(st.sampled_from(scales)), points.shape
        )
    elif shape == "two scales":
        points[::2] *= draw(st.sampled_from(scales))
    elif shape == "next to each other":
        points = np.nextafter(points, np.arange(n)[:, None] % 3 - 1.0)
    return points * draw(st.sampled_from(scales)) + draw(
        st.sampled_from((0.0, 0.0, 5.0, 1e3, 1e6))
    )


def distinct(points, fewest=8):
    """The points without copies, in their order; an example of fewer is passed over."""
    rows = np.sort(np.unique(points, axis=0, return_index=True)[1])
    assume(len(rows) >= fewest)
    return points[rows]


@pytest.mark.parametrize("n_examples", some_of([100, 300], [100]))
def test_every_pair_is_scored_within_bounds_or_refused_in_one_line(n_examples):
    @settings(PROFILE, max_examples=n_examples)
    @given(clouds(fewest=8), clouds(fewest=8), st.booleans(), st.sampled_from(SETTINGS))
    def is_scored_or_refused(real, sim, is_alike, chosen):
        sim = real[: max(1, len(real) - 2)] if is_alike else sim
        try:
            assert not faults_of(evaluated(real, sim, chosen))
        except FidpipeError as error:
            assert str(error).isprintable()

    is_scored_or_refused()


@PROFILE
@given(clouds(fewest=8), st.sampled_from((KEEP_ALL, REFERENCE | KEEP_ALL)))
def test_a_scan_is_identical_with_itself(points, chosen):
    points = distinct(points)
    assume(points.any(axis=1).all() and np.abs(points).max() < FARTHEST_M / 2)
    result = evaluated(points, points, chosen)
    assert set(result.metrics.status) <= {"identical", "too_small"}
    assert result.summary["match_rate"] == 1.0
    for name in ("cdc", "centroid_distance_m", "alignment_rms_m"):
        assert (result.metrics[name] == 0).all(), name
    for name in ("r_lambda", "r_gap", "eigenspectrum_distance"):
        assert (result.metrics[name].dropna() == 0).all(), name


@PROFILE
@given(clouds(), clouds())
def test_distances_of_two_sides_are_the_same_both_ways(real, sim):
    assert chamfer_density_aware(real, sim) == chamfer_density_aware(sim, real)
    to_sim, to_real = nearest_distances(real, sim)
    assert all(map(np.array_equal, nearest_distances(sim, real), (to_real, to_sim)))
    wanted = MetricsSettings(baselines="all")
    forth = compare_points(real, sim, wanted)
    back = compare_points(sim, real, wanted)
    for one, other in zip(forth, back, strict=True):
        if one.name in BOTH_WAYS:
            assert (one.value is None) == (other.value is None), one.name
            assert one.value is None or one.value == pytest.approx(
                other.value, rel=1e-9, abs=1e-300
            ), one.name


@PROFILE
@given(clouds(fewest=8), clouds(fewest=8))
def test_the_scores_of_an_object_are_the_same_both_ways(real, sim):
    """Once its nodes are aligned."""
    real = graph_of(distinct(real), load().graph)
    sim = graph_of(distinct(sim), load().graph)
    selection = select_nodes(real, sim, load().selection)
    back = type(selection)(
        selection.sim_nodes,
        selection.real_nodes,
        selection.sim_influence,
        selection.real_influence,
    )
    forth, back = score_object(real, sim, selection), score_object(sim, real, back)
    for name in (
        "cdc",
        "alignment_rms_m",
        "r_lambda",
        "r_gap",
        "max_eigenvalue_shift",
        "laplacian_change",
    ):
        assert getattr(forth, name) == pytest.approx(getattr(back, name), rel=1e-6, abs=1e-9), (
            name
        )
    assert forth.status == back.status
