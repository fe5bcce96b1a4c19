"""All tables that fidpipe writes: columns, types, nullability, units, keys and versions.

This is the contract with all readers of our Parquet files. `Table.check` is called before a table is written and after
it is read; the metadata of a field has the unit and meaning of the column. Columns of scores come from `metrics`, the
tables of perturb and ablate are in `experiment_tables`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import pyarrow as pa

from .columns import (
    BOOL,
    COMMUNITY,
    CONSTANT,
    FLOAT64,
    INT32,
    LABEL,
    PAIR,
    POINT,
    SIDE,
    SIDES,
    STRING,
    Table,
    column,
    mean_columns,
    score_column,
    table,
)
from .experiment_tables import EXPERIMENT_TABLES
from .metric_catalogue import (
    COVERAGE_REACHES,
    COVERAGE_SCORES,
    INTENSITY_SCORES,
    METRIC,
    OBJECT_METRICS,
    OBJECT_SCORES,
    PAIR_SCORES,
    PIECE_SCORES,
    SHIFT_COLUMNS,
    SURFACE_SCORES,
    reach_words,
)
from .metric_catalogue import (
    RAY_SCORES as RAY_METRICS,
)

GROUND = table(
    "ground",
    ("point_id",),
    PAIR,
    SIDE,
    POINT,
    column("x", FLOAT64, "forward, real sensor's frame", "m"),
    column("y", FLOAT64, "left, real sensor's frame", "m"),
    column("z", FLOAT64, "up, real sensor's frame", "m"),
    column("height_m", FLOAT64, "height along the ground axis, from the road's peak", "m"),
    column("is_ground", BOOL, "below the ground threshold; all other points are object points"),
    column("intensity", FLOAT64, "as in the input file", optional=True),
    LABEL,
    column("instance", INT32, "instance id from the input; 0 if the point has none", optional=True),
)

SENSOR = table(
    "sensor",
    ("side",),
    PAIR,
    SIDE,
    column("model", STRING, "known sensor model with these beams", optional=True),
    column("n_beams", INT32, "number of beams", optional=True),
    column("lowest_deg", FLOAT64, "elevation of the lowest beam", "deg", optional=True),
    column("highest_deg", FLOAT64, "elevation of the highest beam", "deg", optional=True),
    column(
        "origin_height_m",
        FLOAT64,
        "height of the beams' origin above the origin of the file's frame; for two blocks of beams, their mean",
        "m",
        optional=True,
    ),
    column("azimuth_step_deg", FLOAT64, "angle between two firings of a beam", "deg", optional=True),
    column("range_quantum_m", FLOAT64, "ranges are multiples of it; null if not detected", "m", optional=True),
    column("range_noise_m", FLOAT64, "standard deviation along the ray on smooth surfaces", "m", optional=True),
    column("lost_share", FLOAT64, "share of the pulses within visible surfaces that have no return", optional=True),
    column("reason", STRING, "why a value is null", optional=True),
)

GRAPH = table(
    "graph",
    ("src", "dst"),
    PAIR,
    SIDE,
    column("src", INT32, "point id, the smaller of the two"),
    column("dst", INT32, "point id, the larger of the two"),
    column("length_m", pa.float32(), "Euclidean distance: the weight of the edge", "m"),
)

COMMUNITIES = table("communities", ("point_id",), PAIR, SIDE, POINT, COMMUNITY)

OBJECTS = table(
    "objects",
    ("community_id",),
    PAIR,
    SIDE,
    COMMUNITY,
    column(
        "n_points",
        INT32,
        "object points of the community; 0 for a real object without simulated points (reference objects)",
    ),
    column("cx", FLOAT64, "centroid: mean of the member points; null without points", "m", optional=True),
    column("cy", FLOAT64, "centroid", "m", optional=True),
    column("cz", FLOAT64, "centroid", "m", optional=True),
    column("range_m", FLOAT64, "distance of the centroid from the sensor", "m", optional=True),
    column("extent_x", FLOAT64, "axis-aligned size", "m", optional=True),
    column("extent_y", FLOAT64, "axis-aligned size", "m", optional=True),
    column("extent_z", FLOAT64, "axis-aligned size", "m", optional=True),
    column(
        "linearity", FLOAT64, "(l1 - l2) / l1 of the covariance eigenvalues l1 >= l2 >= l3; 0 if l1 is 0", optional=True
    ),
    column("planarity", FLOAT64, "(l2 - l3) / l1", optional=True),
    column("scattering", FLOAT64, "l3 / l1", optional=True),
    column("label", STRING, "most frequent label of the member points", optional=True),
)

MATCHING = table(
    "matching",
    ("real_id", "sim_id"),
    PAIR,
    column("real_id", INT32, "community of the real side; null if hallucinated", optional=True),
    column("sim_id", INT32, "community of the simulated side; null if missing", optional=True),
    column("centroid_distance_m", FLOAT64, "distance between matched centroids", "m", optional=True),
    column("status", STRING, "matched, missing (real only) or hallucinated (simulated only)"),
)

RAYS = table(
    "rays",
    ("beam", "column"),
    PAIR,
    column("beam", INT32, "beam of the real sensor, from the lowest"),
    column("column", INT32, "number of the firing of this beam, from azimuth -180 degrees on"),
    column("real_point_id", INT32, "real return; null for none", optional=True),
    column("sim_point_id", INT32, "simulated return; null for none", optional=True),
    column("real_range_m", FLOAT64, "range of the real return", "m", optional=True),
    column("sim_range_m", FLOAT64, "range at which the real ray meets the simulated surface", "m", optional=True),
    column("outcome", STRING, "same, in_front, behind, dropped, no_surface, sim_only or none"),
    column("incidence_deg", FLOAT64, "angle between the ray and the normal of the surface", "deg", optional=True),
    column("label", STRING, "class of the real return, or of the simulated one", optional=True),
)

RAY_SCORES = table(
    "ray_scores",
    ("by", "band"),
    PAIR,
    column("by", STRING, "all, range, incidence, azimuth or class"),
    column("band", STRING, 'such as "10 to 20 m", or the class; "" for all'),
    *(score_column(metric) for metric in RAY_METRICS),
)

SELECTION = table(
    "selection",
    ("real_id", "sim_id", "rank"),
    PAIR,
    column("real_id", INT32, "community of the real side"),
    column("sim_id", INT32, "community of the simulated side"),
    column("rank", INT32, "rank of the real node by decreasing influence, from 0; ties by point id"),
    column("real_point_id", INT32, "kept node of the real side"),
    column("sim_point_id", INT32, "kept node of the simulated side that is aligned with the real one"),
    column("real_influence", FLOAT64, "row sum of the heat kernel, rounded to 1e-9"),
    column("sim_influence", FLOAT64, "row sum of the heat kernel at the simulated node, rounded to 1e-9"),
)

METRICS = table(
    "metrics",
    ("real_id", "sim_id"),
    PAIR,
    column("real_id", INT32, "community of the real side"),
    column("sim_id", INT32, "community of the simulated side"),
    column("n_real", INT32, "points of the real object"),
    column("n_sim", INT32, "points of the simulated object"),
    column("n_keep", INT32, "aligned nodes: the smaller of n_real and n_sim"),
    *map(score_column, OBJECT_SCORES),
    column("status", STRING, "scored, identical or too_small"),
    column("reason", STRING, "why a score is null", optional=True),
)

COVERAGE = table(
    "coverage",
    ("side", "community_id"),
    PAIR,
    column("side", STRING, "real or sim"),
    column("community_id", INT32, "object of this side; null for the whole side", optional=True),
    column("n_points", INT32, "object points of the object or side"),
    *(
        column(
            f"covered_{reach}",
            FLOAT64,
            f"share of these points with an object point of the other side at most {reach_words(reach)} away",
            optional=True,
        )
        for reach in COVERAGE_REACHES
    ),
    column("median_distance_m", FLOAT64, "median distance of these points to the other side", "m", optional=True),
    column(
        "road_share",
        FLOAT64,
        "share of these points below the ground threshold of the other side (road there); null without a threshold",
        optional=True,
    ),
)

SURFACE = table(
    "surface",
    ("real_id",),
    PAIR,
    column("real_id", INT32, "object of the real side; null for the whole side", optional=True),
    column("n_points", INT32, "sampled real points on planes that the simulated side covers"),
    column("n_directions", INT32, "directions, 0 to 3, in which their normals make a displacement observable"),
    *(score_column(METRIC[name]) for name in SHIFT_COLUMNS),
)

PIECES = table(
    "pieces",
    ("side", "piece_id"),
    PAIR,
    column("side", STRING, "real: the piece is missing; sim: it is invented"),
    column("piece_id", INT32, "piece of this side; 0 is the largest"),
    column("n_points", INT32, "points of the piece"),
    *(column(f"c{axis}", FLOAT64, "centroid: mean of its points", "m") for axis in "xyz"),
    column("range_m", FLOAT64, "distance of the centroid from the sensor", "m"),
    column("bearing_deg", FLOAT64, "direction of the centroid: 0 ahead, 90 left, -90 right", "deg"),
    *(column(f"extent_{axis}", FLOAT64, "axis-aligned size", "m") for axis in "xyz"),
    column("height_m", FLOAT64, "height of its lowest point above the road of its side", "m"),
    column("label", STRING, "most frequent label of its points", optional=True),
    column("fate", STRING, "gone, or moved: a piece of similar size is missing and another invented nearby"),
    column("partner_id", INT32, "piece of the other side that it moved to or from", optional=True),
    *(
        column(f"moved_{axis}_m", FLOAT64, "vector from the real to the simulated piece", "m", optional=True)
        for axis in "xyz"
    ),
)

BASELINES = table(
    "baselines",
    ("real_id", "sim_id", "baseline"),
    PAIR,
    column("real_id", INT32, "community of the real side; null for the whole scans", optional=True),
    column("sim_id", INT32, "community of the simulated side; null for the whole scans", optional=True),
    column("baseline", STRING, "name of the baseline metric, with its convention and unit"),
    column("value", FLOAT64, "value of the baseline metric in `unit`", optional=True),
    column("unit", STRING, "m or m2; null for a plain number", optional=True),
    column("reason", STRING, "why the value is null, or a note about it", optional=True),
)

NVS = table(
    "nvs",
    ("score",),
    PAIR,
    column("score", STRING, "name of the score, with its convention and unit"),
    column("value", FLOAT64, "value of the score in `unit`", optional=True),
    column("unit", STRING, "m, m2 or dB; null for a plain number", optional=True),
    column("reason", STRING, "why the value is null", optional=True),
)

SEEDS = table(
    "seeds",
    ("seed",),
    PAIR,
    column("seed", INT32, "seed of the communities; the first is that of the other tables"),
    *(score_column(metric, optional=False) for metric in PAIR_SCORES),
    *mean_columns("the objects"),
)


def _pair_columns() -> list[pa.Field]:
    """Columns of `pairs`. All columns except name, status and reason may be null for a failed pair."""

    def count(name: str, meaning: str) -> pa.Field:
        return column(name, INT32, meaning, optional=True)

    def number(name: str, meaning: str, unit: str = "") -> pa.Field:
        return column(name, FLOAT64, meaning, unit, optional=True)

    fields = [
        PAIR.with_type(STRING),
        column("status", STRING, "scored or failed"),
        column("reason", STRING, "why the pair failed", optional=True),
    ]
    for side in SIDES:
        fields += [
            count(f"n_{side}_raw", "points in the file"),
            count(f"n_{side}_clean", "points after cleaning"),
            count(f"n_{side}_points", "object points: clean and not ground"),
            number(f"ground_{side}_peak_m", "height of the road's peak along the ground axis", "m"),
            number(f"ground_{side}_threshold_m", "points below this height are ground", "m"),
            number(f"ground_{side}_loss", "variance loss at the threshold"),
            count(f"ground_{side}_iterations", "number of times the threshold was lowered"),
            number(f"ground_{side}_removed_share", "ground points over clean points"),
            number(f"ground_{side}_tilt_deg", "angle of the PCA axis to +Z; above 10 the cut is along +Z", "deg"),
            count(f"n_communities_{side}", "objects of this side"),
        ]
    fields += [
        *(score_column(METRIC[name]) for name in ("n_matched", "n_missing", "n_hallucinated")),
        count("n_scored", "matched objects with spectral scores"),
        count("n_identical", "matched objects with equal Laplacians"),
        count("n_too_small", "matched objects with fewer than 3 nodes"),
        score_column(METRIC["match_rate"]),
        number("median_range_matched_m", "median distance of matched real objects from the sensor", "m"),
        number("median_range_unmatched_m", "median distance of unmatched objects of both sides", "m"),
    ]
    for metric in OBJECT_METRICS:
        fields += [
            number(f"{metric}_mean", f"mean of {metric} over the objects"),
            number(f"{metric}_std", f"standard deviation (n - 1) of {metric} over the objects"),
        ]
    fields += [score_column(metric) for metric in (*COVERAGE_SCORES, *SURFACE_SCORES, *PIECE_SCORES)]
    for side in SIDES:
        fields += [
            count(f"sensor_{side}_beams", "beams of the sensor, estimated from the scan"),
            number(f"sensor_{side}_azimuth_step_deg", "angle between two firings of a beam", "deg"),
            number(f"sensor_{side}_range_quantum_m", "ranges are multiples of it; null if not detected", "m"),
            number(f"sensor_{side}_range_noise_m", "standard deviation along the ray on smooth surfaces", "m"),
            number(f"sensor_{side}_lost_share", "share of the pulses within visible surfaces that have no return"),
        ]
    fields += [score_column(metric) for metric in RAY_METRICS]
    fields.append(column("rays_reason", STRING, "why the pair has no rays", optional=True))
    fields += [score_column(metric) for metric in INTENSITY_SCORES]
    fields.append(column("intensity_note", STRING, "what is unusual about the intensities", optional=True))
    return fields


PAIRS = table("pairs", ("pair_id",), *_pair_columns())

TIMINGS = table(
    "timings",
    ("pair_id", "stage", "side", "step"),
    PAIR.with_type(STRING),
    column("side", STRING, "real, sim, or null for a step of the pair", optional=True),
    column("stage", STRING, "name of the stage, such as ground"),
    column("step", STRING, "read, write, or a step of the method"),
    column("seconds", FLOAT64, "wall time of the step", "s"),
    column("reused", BOOL, "the result was reused: the seconds are those of the run that computed it"),
)

_OF_PAIRS = (
    *(GROUND, SENSOR, GRAPH, COMMUNITIES, OBJECTS, MATCHING, COVERAGE, SURFACE, PIECES, RAYS, RAY_SCORES),
    *(SELECTION, METRICS, BASELINES, SEEDS, NVS),
)
#: Names of the tables with a file per pair, or per side of a pair.
PAIR_TABLES = tuple(own.name for own in _OF_PAIRS)
#: All tables by name; the name is also the folder or file in a run.
TABLES = {
    own.name: own
    for own in (
        *(*_OF_PAIRS, PAIRS, TIMINGS),
        *EXPERIMENT_TABLES,
    )
}


_TYPES = {str(CONSTANT): "string", "double": "float64", "float": "float32"}


def to_markdown() -> str:
    """Markdown of all tables: a heading and the columns of each, except the pair and side that they begin with."""
    common = (PAIR.metadata, SIDE.metadata)
    return "\n".join(f"### {table.name}\n\n{columns_to_markdown(table, common)}" for table in TABLES.values())


def columns_to_markdown(table: Table, without: Sequence[dict[bytes, bytes]] = ()) -> str:
    """Markdown of a table: its sort keys; type, unit, nullability and meaning of its columns, equal ones in one row."""
    columns: dict[tuple[str, ...], list[str]] = {}
    for field in table.schema:
        if field.metadata in without:
            continue
        kind = _TYPES.get(str(field.type), str(field.type))
        unit, meaning = (field.metadata.get(name, b"").decode() for name in (b"unit", b"meaning"))
        meaning = re.sub(r"^(mean|standard deviation \(n - 1\)) of \w+ over", r"\1 of the score over", meaning)
        columns.setdefault((kind, unit, "yes" if field.nullable else "", meaning), []).append(f"`{field.name}`")
    rows = [f"| {', '.join(names)} | {' | '.join(cells)} |" for cells, names in columns.items()]
    head = ["| column | type | unit | null | meaning |", "|---|---|---|---|---|"]
    return "\n".join([f"Sorted by {', '.join(f'`{key}`' for key in table.keys)}.", "", *head, *rows]) + "\n"
