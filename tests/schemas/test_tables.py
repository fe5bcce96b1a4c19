import numpy as np
import pyarrow as pa
import pytest

from fidpipe.schemas.tables import COMMUNITIES, MATCHING, METRICS, PAIRS, TABLES


def test_every_column_says_what_it_means():
    for table in TABLES.values():
        for field in table.schema:
            assert field.metadata[b"meaning"], (table.name, field.name)


def test_every_key_is_a_column():
    for table in TABLES.values():
        assert set(table.keys) <= set(table.schema.names)


def test_the_pairs_table_has_the_columns_of_the_contract():
    names = PAIRS.schema.names
    assert names[:3] == ["pair_id", "status", "reason"]
    assert names[3:13] == [
        "n_real_raw",
        "n_real_clean",
        "n_real_points",
        "ground_real_peak_m",
        "ground_real_threshold_m",
        "ground_real_loss",
        "ground_real_iterations",
        "ground_real_removed_share",
        "ground_real_tilt_deg",
        "n_communities_real",
    ]
    sensor = ["beams", "azimuth_step_deg", "range_quantum_m", "range_noise_m", "lost_share"]
    assert names[-10:] == [f"sensor_{side}_{name}" for side in ("real", "sim") for name in sensor]
    names = names[:-10]
    assert names[-5:] == [
        "n_missing_pieces",
        "n_invented_pieces",
        "missing_pieces_share",
        "invented_pieces_share",
        "found",
    ]
    names = names[:-5]
    assert names[-16:-14] == ["alignment_rms_m_mean", "alignment_rms_m_std"]
    assert names[-14:-8] == [f"covered_{side}_{reach}" for side in ("real", "sim") for reach in ("0p1m", "0p3m", "1m")]
    assert names[-8:-4] == ["shift_x_m", "shift_y_m", "shift_z_m", "shift_m"]
    assert names[-4:] == ["roughness_real_m", "roughness_sim_m", "roughness_bias_m", "roughness_area_m"]
    assert len(names) == 3 + 2 * 10 + 9 + 2 * 8 + 6 + 8


def test_a_missing_column_is_refused():
    rows = COMMUNITIES.build({"pair_id": "a", "side": "real", "point_id": np.arange(3), "community_id": np.zeros(3)})
    with pytest.raises(ValueError, match="table communities: columns .* found"):
        COMMUNITIES.check(rows.drop_columns(["side"]))


def test_another_type_is_refused():
    rows = COMMUNITIES.build({"pair_id": "a", "side": "real", "point_id": np.arange(3), "community_id": np.zeros(3)})
    wrong = rows.set_column(2, "point_id", pa.array([1, 2, 3], pa.int64()))
    with pytest.raises(ValueError, match="column point_id: int64 found, int32 wanted"):
        COMMUNITIES.check(wrong)


def test_a_null_where_none_is_allowed_is_refused():
    with pytest.raises(ValueError, match="table metrics, column n_real: 1 nulls found"):
        METRICS.from_rows([{"pair_id": "a", "real_id": 0, "sim_id": 0, "status": "scored"}])


def test_rows_are_sorted_by_key_with_nulls_last():
    rows = [
        {"sim_id": 4, "status": "hallucinated"},
        {"real_id": 3, "status": "missing"},
        {"real_id": 1, "status": "missing"},
    ]
    table = MATCHING.from_rows([{"pair_id": "a", **row} for row in rows])
    assert table.column("real_id").to_pylist() == [1, 3, None]
