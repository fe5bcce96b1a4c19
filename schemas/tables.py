"""The tables that fidpipe writes: columns, types, nullability, units, keys and versions.

This is the contract with everybody who reads our Parquet. `Table.check` is called before a table is written and after
it is read; a column's unit and meaning stand in the metadata of its field here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

SIDES = ("real", "sim")

#: The object metrics whose mean and standard deviation stand in `pairs`, in that order.
OBJECT_METRICS = (
    "centroid_distance_m",
    "cdc",
    "r_lambda",
    "r_gap",
    "max_eigenvalue_shift",
    "laplacian_change",
    "eigenspectrum_distance",
    "alignment_rms_m",
)


@dataclass(frozen=True)
class Table:
    """One table: its name, its columns, and the columns by which its rows are sorted."""

    name: str
    schema: pa.Schema
    keys: tuple[str, ...]
    version: int = 1

    def check(self, table: pa.Table) -> pa.Table:
        """The table itself, if names, types and nullability are as agreed.

        Raises
        ------
        ValueError
            A column is missing, surplus, of another type, or has a null that the schema forbids.
        """
        if table.schema.names != self.schema.names:
            raise ValueError(f"table {self.name}: columns {table.schema.names} found, {self.schema.names} wanted")
        for field in self.schema:
            column = table.column(field.name)
            if column.type != field.type and not (field.type == _SAME and column.type == pa.string()):
                raise ValueError(f"table {self.name}, column {field.name}: {column.type} found, {field.type} wanted")
            if not field.nullable and column.null_count:
                raise ValueError(
                    f"table {self.name}, column {field.name}: {column.null_count} nulls found, none allowed"
                )
        return table

    def build(self, columns: dict[str, Any], n_rows: int | None = None) -> pa.Table:
        """A checked table from arrays; a single string, number or None fills its column for `n_rows` rows."""
        if n_rows is None:
            n_rows = next(len(value) for value in columns.values() if _is_column(value))
        arrays = []
        for field in self.schema:
            value = columns[field.name]
            if _is_column(value):
                arrays.append(pa.array(value, type=field.type, from_pandas=False))
            elif field.type == _SAME:
                arrays.append(pa.DictionaryArray.from_arrays(np.zeros(n_rows, dtype=np.int32), pa.array([value])))
            else:
                arrays.append(pa.repeat(pa.scalar(value, type=field.type), n_rows))
        return self.check(pa.Table.from_arrays(arrays, schema=self.schema))

    @property
    def same(self) -> list[str]:
        """The columns that are dictionaries in memory."""
        return [field.name for field in self.schema if field.type == _SAME]

    def plain(self, table: pa.Table) -> pa.Table:
        """The table with plain strings in place of dictionaries."""
        plain = [field.with_type(pa.string()) if field.type == _SAME else field for field in table.schema]
        return table.cast(pa.schema(plain))

    def from_rows(self, rows: Iterable[dict[str, Any]]) -> pa.Table:
        """A checked table from dictionaries, sorted by the table's keys (nulls last); absent values are null."""
        table = pa.Table.from_pylist(list(rows), schema=self.schema)
        return self.check(table.sort_by([(key, "ascending") for key in self.keys]))


def _is_column(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str)


def _field(name: str, kind: pa.DataType, meaning: str, unit: str = "", optional: bool = False) -> pa.Field:
    metadata = {"meaning": meaning}
    if unit:
        metadata["unit"] = unit
    return pa.field(name, kind, nullable=optional, metadata=metadata)


_STRING, _ID, _REAL, _FLAG, _COUNT = pa.string(), pa.int32(), pa.float64(), pa.bool_(), pa.int32()
#: Strings that are the same in all rows of a file: in memory a dictionary, in Parquet plain strings.
_SAME = pa.dictionary(pa.int32(), pa.string())

_PAIR = _field("pair_id", _SAME, "name of the scan pair")
_SIDE = _field("side", _SAME, "real or sim")
_POINT = _field("point_id", _ID, "row of the point in its input file, from 0")
_COMMUNITY = _field("community_id", _ID, "object of this side; 0 is the largest")
_LABEL = _field("label", _STRING, "semantic class, where the input has labels", optional=True)

GROUND = Table(
    "ground",
    pa.schema(
        [
            _PAIR,
            _SIDE,
            _POINT,
            _field("x", _REAL, "forward, real sensor's frame", "m"),
            _field("y", _REAL, "left, real sensor's frame", "m"),
            _field("z", _REAL, "up, real sensor's frame", "m"),
            _field("height_m", _REAL, "height along the ground axis, from the road's peak", "m"),
            _field("is_ground", _FLAG, "below the ground threshold; only the others go on"),
            _field("intensity", _REAL, "as in the input file", optional=True),
            _LABEL,
        ]
    ),
    ("point_id",),
)

GRAPH = Table(
    "graph",
    pa.schema(
        [
            _PAIR,
            _SIDE,
            _field("src", _ID, "point id, the smaller of the two"),
            _field("dst", _ID, "point id, the larger of the two"),
            _field("length_m", pa.float32(), "Euclidean distance: the weight of the edge", "m"),
        ]
    ),
    ("src", "dst"),
)

COMMUNITIES = Table("communities", pa.schema([_PAIR, _SIDE, _POINT, _COMMUNITY]), ("point_id",))

OBJECTS = Table(
    "objects",
    pa.schema(
        [
            _PAIR,
            _SIDE,
            _COMMUNITY,
            _field("n_points", _COUNT, "object points of the community"),
            _field("cx", _REAL, "centroid: mean of the member points", "m"),
            _field("cy", _REAL, "centroid", "m"),
            _field("cz", _REAL, "centroid", "m"),
            _field("range_m", _REAL, "distance of the centroid from the sensor", "m"),
            _field("extent_x", _REAL, "axis-aligned size", "m"),
            _field("extent_y", _REAL, "axis-aligned size", "m"),
            _field("extent_z", _REAL, "axis-aligned size", "m"),
            _field("linearity", _REAL, "(l1 - l2) / l1 of the covariance eigenvalues l1 >= l2 >= l3; 0 where l1 is 0"),
            _field("planarity", _REAL, "(l2 - l3) / l1"),
            _field("scattering", _REAL, "l3 / l1"),
            _field("label", _STRING, "most frequent label of the member points", optional=True),
        ]
    ),
    ("community_id",),
)

MATCHING = Table(
    "matching",
    pa.schema(
        [
            _PAIR,
            _field("real_id", _ID, "community of the real side; null where hallucinated", optional=True),
            _field("sim_id", _ID, "community of the simulated side; null where missing", optional=True),
            _field("centroid_distance_m", _REAL, "between matched centroids", "m", optional=True),
            _field("status", _STRING, "matched, missing (real only) or hallucinated (simulated only)"),
        ]
    ),
    ("real_id", "sim_id"),
)

SELECTION = Table(
    "selection",
    pa.schema(
        [
            _PAIR,
            _field("real_id", _ID, "community of the real side"),
            _field("sim_id", _ID, "community of the simulated side"),
            _field("rank", _ID, "from 0, by decreasing real influence, ties by point id"),
            _field("real_point_id", _ID, "kept node of the real side"),
            _field("sim_point_id", _ID, "kept node of the simulated side that is aligned with it"),
            _field("real_influence", _REAL, "row sum of the heat kernel, rounded to 1e-9"),
            _field("sim_influence", _REAL, "the same of the simulated node"),
        ]
    ),
    ("real_id", "sim_id", "rank"),
)

METRICS = Table(
    "metrics",
    pa.schema(
        [
            _PAIR,
            _field("real_id", _ID, "community of the real side"),
            _field("sim_id", _ID, "community of the simulated side"),
            _field("n_real", _COUNT, "points of the real object"),
            _field("n_sim", _COUNT, "points of the simulated object"),
            _field("n_keep", _COUNT, "aligned nodes, the smaller of the two"),
            _field("centroid_distance_m", _REAL, "between the centroids", "m"),
            _field("cdc", _REAL, "density-aware Chamfer distance of the paper, 0 to 2"),
            _field("r_lambda", _REAL, "max_eigenvalue_shift / laplacian_change, 0 to 1", optional=True),
            _field("r_gap", _REAL, "change of the spectral gap / (2 laplacian_change), 0 to 0.5", optional=True),
            _field("max_eigenvalue_shift", _REAL, "largest shift of an ordered eigenvalue", optional=True),
            _field("laplacian_change", _REAL, "spectral norm of the difference of the Laplacians", optional=True),
            _field("eigenspectrum_distance", _REAL, "Euclidean distance of the ordered spectra", optional=True),
            _field("gap_real", _REAL, "second smallest eigenvalue less the smallest, real", optional=True),
            _field("gap_sim", _REAL, "second smallest eigenvalue less the smallest, simulated", optional=True),
            _field("alignment_rms_m", _REAL, "root mean square distance of aligned nodes, both sides centred", "m"),
            _field("status", _STRING, "scored, identical or too_small"),
            _field("reason", _STRING, "why a score is null", optional=True),
        ]
    ),
    ("real_id", "sim_id"),
)


BASELINES = Table(
    "baselines",
    pa.schema(
        [
            _PAIR,
            _field("real_id", _ID, "community of the real side; null for the whole scans", optional=True),
            _field("sim_id", _ID, "community of the simulated side; null for the whole scans", optional=True),
            _field("baseline", _STRING, "name of the distance, with its convention and unit"),
            _field("value", _REAL, "in the unit beside it", optional=True),
            _field("unit", _STRING, "m or m2; null for a plain number", optional=True),
            _field("reason", _STRING, "why the value is null, or what is to be known of it", optional=True),
        ]
    ),
    ("real_id", "sim_id", "baseline"),
)


#: The scores of a pair that are repeated under other seeds.
SEEDED_SCORES = (
    "n_communities_real",
    "n_communities_sim",
    "n_matched",
    "n_missing",
    "n_hallucinated",
    "match_rate",
    *(f"{metric}_mean" for metric in OBJECT_METRICS),
)

SEEDS = Table(
    "seeds",
    pa.schema(
        [
            _PAIR,
            _field("seed", _ID, "of the communities; the first is that of the other tables"),
            _field("n_communities_real", _COUNT, "objects of the real side"),
            _field("n_communities_sim", _COUNT, "objects of the simulated side"),
            _field("n_matched", _COUNT, "objects that both sides have"),
            _field("n_missing", _COUNT, "real objects without a simulated one"),
            _field("n_hallucinated", _COUNT, "simulated objects without a real one"),
            _field("match_rate", _REAL, "matched / max(communities of either side)"),
            *(
                _field(f"{metric}_mean", _REAL, f"mean of {metric} over the objects", optional=True)
                for metric in OBJECT_METRICS
            ),
        ]
    ),
    ("seed",),
)


def _pairs_schema() -> pa.Schema:
    """Columns of `pairs`: of a failed pair all but its name, status and reason may be null."""

    def count(name: str, meaning: str) -> pa.Field:
        return _field(name, _COUNT, meaning, optional=True)

    def real(name: str, meaning: str, unit: str = "") -> pa.Field:
        return _field(name, _REAL, meaning, unit, optional=True)

    fields = [
        _PAIR.with_type(_STRING),
        _field("status", _STRING, "scored or failed"),
        _field("reason", _STRING, "why the pair failed", optional=True),
    ]
    for side in SIDES:
        fields += [
            count(f"n_{side}_raw", "points in the file"),
            count(f"n_{side}_clean", "points after cleaning"),
            count(f"n_{side}_points", "object points: clean and not ground"),
            real(f"ground_{side}_peak_m", "height of the road along the ground axis", "m"),
            real(f"ground_{side}_threshold_m", "points below this height are ground", "m"),
            real(f"ground_{side}_loss", "variance loss at the threshold"),
            count(f"ground_{side}_iterations", "how often the threshold was lowered"),
            real(f"ground_{side}_removed_share", "ground points over clean points"),
            real(f"ground_{side}_tilt_deg", "angle of the PCA axis to +Z; above 10 the cut uses +Z", "deg"),
            count(f"n_communities_{side}", "objects of this side"),
        ]
    fields += [
        count("n_matched", "objects that both sides have"),
        count("n_missing", "real objects without a simulated one"),
        count("n_hallucinated", "simulated objects without a real one"),
        count("n_scored", "matched objects with spectral scores"),
        count("n_identical", "matched objects whose Laplacians do not differ"),
        count("n_too_small", "matched objects with fewer than 3 nodes"),
        real("match_rate", "matched / max(communities of either side)"),
        real("median_range_matched_m", "median distance of matched real objects from the sensor", "m"),
        real("median_range_unmatched_m", "median distance of unmatched objects of both sides", "m"),
    ]
    for metric in OBJECT_METRICS:
        fields += [
            real(f"{metric}_mean", f"mean of {metric} over the objects"),
            real(f"{metric}_std", f"standard deviation (n - 1) of {metric} over the objects"),
        ]
    return pa.schema(fields)


PAIRS = Table("pairs", _pairs_schema(), ("pair_id",))

TIMINGS = Table(
    "timings",
    pa.schema(
        [
            _PAIR.with_type(_STRING),
            _field("side", _STRING, "real, sim, or null for a step of the pair", optional=True),
            _field("stage", _STRING, "ground, graph, communities, matching, selection, metrics, baselines or seeds"),
            _field("step", _STRING, "read, write, or a step of the method"),
            _field("seconds", _REAL, "wall time of the step", "s"),
            _field("reused", _FLAG, "the result was reused: the seconds are of the run that made it"),
        ]
    ),
    ("pair_id", "stage", "side", "step"),
)

_LEVEL = [
    _field("kind", _STRING, "noise, dropout, rigid, hallucination or density"),
    _field("amount", _REAL, "noise: m; dropout, hallucination: share of the points; rigid: degrees; density: factor"),
    _field("shift_m", _REAL, "rigid: length of the translation; else 0", "m"),
]
_REPEAT = [
    _field("repeat", _ID, "from 0"),
    _field("seed", pa.int64(), "of the random numbers of this repeat, derived from the job's name"),
]
_UNDER_TEST = [
    _PAIR.with_type(_STRING),
    _field("community_id", _ID, "object of the unaltered scan"),
    _field("object", _STRING, "class of the object: its label or its shape, or its number"),
]

PERTURB_GLOBAL = Table(
    "perturb_global",
    pa.schema(
        [
            _PAIR.with_type(_STRING),
            *_LEVEL,
            *_REPEAT,
            _field("n_points", _COUNT, "object points of the unaltered scan"),
            _field("n_points_altered", _COUNT, "object points of the altered scan"),
            _field("n_communities", _COUNT, "objects of the unaltered scan"),
            _field("n_communities_altered", _COUNT, "objects of the altered scan", optional=True),
            _field("n_matched", _COUNT, "objects that both have", optional=True),
            _field("n_identical", _COUNT, "matched objects whose Laplacians do not differ", optional=True),
            _field("n_too_small", _COUNT, "matched objects with fewer than 3 nodes", optional=True),
            _field("match_rate", _REAL, "matched / max(communities of either)", optional=True),
            *(
                _field(f"{name}_mean", _REAL, f"mean of {name} over matched objects", optional=True)
                for name in OBJECT_METRICS
            ),
            _field("reason", _STRING, "why nothing could be computed", optional=True),
        ]
    ),
    ("pair_id", "kind", "shift_m", "amount", "repeat"),
)

PERTURB_OBJECTS = Table(
    "perturb_objects",
    pa.schema(
        [
            *_UNDER_TEST,
            *_LEVEL,
            *_REPEAT,
            _field("n_points", _COUNT, "points of the unaltered object"),
            _field("n_points_altered", _COUNT, "points of the altered object"),
            *(
                _field(name, _REAL, "of the altered against the unaltered object, as in metrics", optional=True)
                for name in OBJECT_METRICS
            ),
            _field("status", _STRING, "scored, identical or too_small"),
            _field("reason", _STRING, "why a score is null", optional=True),
        ]
    ),
    ("pair_id", "community_id", "kind", "shift_m", "amount", "repeat"),
)

PERTURB_BASELINES = Table(
    "perturb_baselines",
    pa.schema(
        [
            *_UNDER_TEST,
            *_LEVEL,
            *_REPEAT,
            _field("baseline", _STRING, "name of the distance, with its convention and unit, as in baselines"),
            _field("unit", _STRING, "of the value; null for a plain number", optional=True),
            _field("value", _REAL, "of the altered against the unaltered object", optional=True),
            _field("reason", _STRING, "why the value is null, or what is to be known of it", optional=True),
        ]
    ),
    ("pair_id", "community_id", "kind", "shift_m", "amount", "repeat", "baseline"),
)

PERTURB_SUMMARY = Table(
    "perturb_summary",
    pa.schema(
        [
            _field("scope", _STRING, "global (whole scan) or object"),
            _field("object", _STRING, "class of the object; null where global", optional=True),
            *_LEVEL,
            _field("metric", _STRING, "column of perturb_global or perturb_objects, or baseline of perturb_baselines"),
            _field("n", _COUNT, "repeats, over all scans, in which the metric could be computed"),
            _field("mean", _REAL, "over these", optional=True),
            _field("std", _REAL, "standard deviation (n - 1) over these", optional=True),
        ]
    ),
    ("scope", "object", "kind", "shift_m", "amount", "metric"),
)

_ABLATED = [
    _field("k", _COUNT, "graph.k"),
    _field("tau_m", _REAL, "graph.tau_m", "m"),
    _field("delta_m", _REAL, "matching.delta_m", "m"),
    _field("t", _REAL, "selection.t"),
]

ABLATE = Table(
    "ablate",
    pa.schema(
        [
            _PAIR.with_type(_STRING),
            *_ABLATED,
            _field("n_communities_real", _COUNT, "objects of the real side"),
            _field("n_communities_sim", _COUNT, "objects of the simulated side"),
            _field("n_matched", _COUNT, "objects that both sides have"),
            _field("match_rate", _REAL, "matched / max(communities of either side)"),
            *(
                _field(f"{name}_mean", _REAL, f"mean of {name} over matched objects", optional=True)
                for name in OBJECT_METRICS
            ),
        ]
    ),
    ("pair_id", "k", "tau_m", "delta_m", "t"),
)

ABLATE_SUMMARY = Table(
    "ablate_summary",
    pa.schema(
        [
            *_ABLATED,
            _field("metric", _STRING, "column of ablate"),
            _field("n_pairs", _COUNT, "pairs in which the metric could be computed"),
            _field("mean", _REAL, "over these", optional=True),
            _field("std", _REAL, "standard deviation (n - 1) over these", optional=True),
        ]
    ),
    ("k", "tau_m", "delta_m", "t", "metric"),
)

#: All tables by name; the name is also the folder or file in a run.
TABLES = {
    table.name: table
    for table in (
        *(GROUND, GRAPH, COMMUNITIES, OBJECTS, MATCHING, SELECTION, METRICS, BASELINES, SEEDS, PAIRS, TIMINGS),
        *(PERTURB_GLOBAL, PERTURB_OBJECTS, PERTURB_BASELINES, PERTURB_SUMMARY, ABLATE, ABLATE_SUMMARY),
    )
}
