import numpy as np
import pyarrow as pa
import pytest

from fidpipe.schemas.tables import TABLES


def test_every_column_says_what_it_means():
    for table in TABLES.values():
        for field in table.schema:
            assert field.metadata[b"meaning"], (table.name, field.name)


def test_a_missing_column_and_another_type_are_rejected():
    columns = {
        "pair_id": "a",
        "side": "real",
        "point_id": np.arange(3),
        "community_id": np.zeros(3),
    }
    rows = TABLES["communities"].build(columns)
    with pytest.raises(ValueError, match="table communities: .*side"):
        TABLES["communities"].check(rows.drop_columns(["side"]))
    wrong = rows.set_column(2, "point_id", pa.array([1, 2, 3], pa.int64()))
    with pytest.raises(ValueError, match="got .*point_id int64"):
        TABLES["communities"].check(wrong)


def test_a_null_where_none_is_allowed_is_refused():
    with pytest.raises(ValueError, match="table metrics, column n_real"):
        TABLES["metrics"].from_rows(
            [{"pair_id": "a", "real_id": 0, "sim_id": 0, "status": "scored"}]
        )


def test_rows_are_sorted_by_key_with_nulls_last():
    rows = [
        {"sim_id": 4, "status": "extra"},
        {"real_id": 3, "status": "not_found"},
        {"real_id": 1, "status": "not_found"},
    ]
    table = TABLES["matching"].from_rows([{"pair_id": "a", **row} for row in rows])
    assert table.column("real_id").to_pylist() == [1, 3, None]
