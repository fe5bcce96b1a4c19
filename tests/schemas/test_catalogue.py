"""The catalogue of scores, against the tables, the functions that compute, and the documentation."""

from pathlib import Path

import pytest

from fidpipe.schemas.data_files import read_rows
from fidpipe.schemas.metric_catalogue import (
    BASELINE_NAMES,
    METRIC,
    OBJECT_METRICS,
    metric_of,
    metrics_in,
    scores_in,
    scores_of,
)
from fidpipe.schemas.settings import MetricsSettings, SelectionSettings
from fidpipe.schemas.tables import TABLES
from fidpipe.stages.baselines import compare_points
from fidpipe.stages.metrics import score_object
from fidpipe.stages.selection import select_nodes
from scenes import box, subgraph


def test_no_column_stands_in_the_catalogue_twice():
    assert len(METRIC) == len(read_rows("metrics"))


def test_every_score_of_an_object_is_a_column_with_its_meaning_and_unit():
    for name in scores_of("object"):
        metric = METRIC[name]
        field = TABLES["metrics"].schema.field(name)
        assert field.metadata[b"meaning"].decode() == metric.meaning
        assert field.metadata.get(b"unit", b"").decode() == (metric.unit or "")


def test_every_mean_of_a_pair_leads_back_to_its_score():
    means = [name for name in TABLES["pairs"].schema.names if name.endswith("_mean")]
    assert [metric_of(name).column for name in means] == list(OBJECT_METRICS)
    with pytest.raises(KeyError):
        metric_of("n_nothing")


def test_a_heading_has_its_unit_and_a_scale_its_better_end_first():
    assert METRIC["centroid_distance_m"].label == "offset (m)"
    assert METRIC["cdc"].label == "CDC"
    assert METRIC["alignment_rms_m"].narrow_label == "align\n(m)"
    assert METRIC["match_rate"].narrow_label == "match\nrate"
    assert METRIC["chamfer_squared_m2"].label == "chamfer_squared_m2 (m²)"
    assert METRIC["match_rate"].scale == "1 best, 0 worst"
    assert METRIC["r_gap"].scale == "0 best, 0.5 worst"
    assert METRIC["gap_real"].scale == ""


def test_a_score_is_shown_in_known_places_and_without_a_position_last():
    places = {place for metric in METRIC.values() for place in metric.shown_in}
    docs = (Path(__file__).parents[2] / "docs" / "extending.md").read_text("utf-8")
    assert [place for place in places if f"`{place}`" not in docs] == []
    assert set(scores_in("object")) == set(scores_of("object"))
    for place in places:
        positions = [metric.shown_in[place] for metric in metrics_in(place)]
        assert positions == list(range(1, len(positions) + 1)), place
    for metric in metrics_in("compare"):
        assert metric.family, metric.column
        assert metric.least, metric.column


@pytest.fixture(scope="module")
def twice():
    """An object, and its nodes aligned with itself."""
    own = subgraph(box([5, 3, 0], [4, 2, 1.5], 120))
    return own, select_nodes(own, own, SelectionSettings())


def test_the_baselines_that_are_computed_are_those_of_the_catalogue_and_identical_objects_have_their_value(
    twice,
):
    own, chosen = twice
    found = compare_points(
        own.points, own.points, MetricsSettings(baselines=BASELINE_NAMES), nodes=chosen
    )
    assert [(each.name, each.unit) for each in found] == [
        (name, METRIC[name].unit)
        for name in scores_of("baseline")
        if METRIC[name].method != "nvs"
    ]
    for each in found:
        if each.value is not None:
            assert each.value == pytest.approx(METRIC[each.name].equal, abs=1e-6), each.name


def test_identical_objects_have_the_value_of_the_catalogue_in_every_own_score(twice):
    own, chosen = twice
    scores = score_object(own, own, chosen)
    for name in scores_of("object"):
        equal = METRIC[name].equal
        if equal is not None and hasattr(scores, name):
            assert getattr(scores, name) == pytest.approx(equal, abs=1e-9), name
