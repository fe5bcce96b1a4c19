"""The tables that fidpipe writes: columns, types, nullability, units, keys and versions.

This is the contract with everybody who reads our Parquet. `Table.check` is called before a table is written and after
it is read; a column's unit and meaning stand in the metadata of its field here. Leaves to others: what a table is
(`columns`), the tables of perturb and ablate (`experiment_tables`).
"""

from __future__ import annotations

import pyarrow as pa

from .columns import (
    COMMUNITY,
    COUNT,
    FLAG,
    ID,
    LABEL,
    OBJECT_METRICS,
    PAIR,
    POINT,
    REAL,
    SIDE,
    SIDES,
    STRING,
    Table,
    column,
)
from .experiment_tables import EXPERIMENT_TABLES

GROUND = Table(
    "ground",
    pa.schema(
        [
            PAIR,
            SIDE,
            POINT,
            column("x", REAL, "forward, real sensor's frame", "m"),
            column("y", REAL, "left, real sensor's frame", "m"),
            column("z", REAL, "up, real sensor's frame", "m"),
            column("height_m", REAL, "height along the ground axis, from the road's peak", "m"),
            column("is_ground", FLAG, "below the ground threshold; only the others go on"),
            column("intensity", REAL, "as in the input file", optional=True),
            LABEL,
        ]
    ),
    ("point_id",),
)

GRAPH = Table(
    "graph",
    pa.schema(
        [
            PAIR,
            SIDE,
            column("src", ID, "point id, the smaller of the two"),
            column("dst", ID, "point id, the larger of the two"),
            column("length_m", pa.float32(), "Euclidean distance: the weight of the edge", "m"),
        ]
    ),
    ("src", "dst"),
)

COMMUNITIES = Table("communities", pa.schema([PAIR, SIDE, POINT, COMMUNITY]), ("point_id",))

OBJECTS = Table(
    "objects",
    pa.schema(
        [
            PAIR,
            SIDE,
            COMMUNITY,
            column("n_points", COUNT, "object points of the community"),
            column("cx", REAL, "centroid: mean of the member points", "m"),
            column("cy", REAL, "centroid", "m"),
            column("cz", REAL, "centroid", "m"),
            column("range_m", REAL, "distance of the centroid from the sensor", "m"),
            column("extent_x", REAL, "axis-aligned size", "m"),
            column("extent_y", REAL, "axis-aligned size", "m"),
            column("extent_z", REAL, "axis-aligned size", "m"),
            column("linearity", REAL, "(l1 - l2) / l1 of the covariance eigenvalues l1 >= l2 >= l3; 0 where l1 is 0"),
            column("planarity", REAL, "(l2 - l3) / l1"),
            column("scattering", REAL, "l3 / l1"),
            column("label", STRING, "most frequent label of the member points", optional=True),
        ]
    ),
    ("community_id",),
)

MATCHING = Table(
    "matching",
    pa.schema(
        [
            PAIR,
            column("real_id", ID, "community of the real side; null where hallucinated", optional=True),
            column("sim_id", ID, "community of the simulated side; null where missing", optional=True),
            column("centroid_distance_m", REAL, "between matched centroids", "m", optional=True),
            column("status", STRING, "matched, missing (real only) or hallucinated (simulated only)"),
        ]
    ),
    ("real_id", "sim_id"),
)

SELECTION = Table(
    "selection",
    pa.schema(
        [
            PAIR,
            column("real_id", ID, "community of the real side"),
            column("sim_id", ID, "community of the simulated side"),
            column("rank", ID, "from 0, by decreasing real influence, ties by point id"),
            column("real_point_id", ID, "kept node of the real side"),
            column("sim_point_id", ID, "kept node of the simulated side that is aligned with it"),
            column("real_influence", REAL, "row sum of the heat kernel, rounded to 1e-9"),
            column("sim_influence", REAL, "the same of the simulated node"),
        ]
    ),
    ("real_id", "sim_id", "rank"),
)

METRICS = Table(
    "metrics",
    pa.schema(
        [
            PAIR,
            column("real_id", ID, "community of the real side"),
            column("sim_id", ID, "community of the simulated side"),
            column("n_real", COUNT, "points of the real object"),
            column("n_sim", COUNT, "points of the simulated object"),
            column("n_keep", COUNT, "aligned nodes, the smaller of the two"),
            column("centroid_distance_m", REAL, "between the centroids", "m"),
            column("cdc", REAL, "density-aware Chamfer distance of the paper, 0 to 2"),
            column("r_lambda", REAL, "max_eigenvalue_shift / laplacian_change, 0 to 1", optional=True),
            column("r_gap", REAL, "change of the spectral gap / (2 laplacian_change), 0 to 0.5", optional=True),
            column("max_eigenvalue_shift", REAL, "largest shift of an ordered eigenvalue", optional=True),
            column("laplacian_change", REAL, "spectral norm of the difference of the Laplacians", optional=True),
            column("eigenspectrum_distance", REAL, "Euclidean distance of the ordered spectra", optional=True),
            column("gap_real", REAL, "second smallest eigenvalue less the smallest, real", optional=True),
            column("gap_sim", REAL, "second smallest eigenvalue less the smallest, simulated", optional=True),
            column("alignment_rms_m", REAL, "root mean square distance of aligned nodes, both sides centred", "m"),
            column("status", STRING, "scored, identical or too_small"),
            column("reason", STRING, "why a score is null", optional=True),
        ]
    ),
    ("real_id", "sim_id"),
)


BASELINES = Table(
    "baselines",
    pa.schema(
        [
            PAIR,
            column("real_id", ID, "community of the real side; null for the whole scans", optional=True),
            column("sim_id", ID, "community of the simulated side; null for the whole scans", optional=True),
            column("baseline", STRING, "name of the distance, with its convention and unit"),
            column("value", REAL, "in the unit beside it", optional=True),
            column("unit", STRING, "m or m2; null for a plain number", optional=True),
            column("reason", STRING, "why the value is null, or what is to be known of it", optional=True),
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
            PAIR,
            column("seed", ID, "of the communities; the first is that of the other tables"),
            column("n_communities_real", COUNT, "objects of the real side"),
            column("n_communities_sim", COUNT, "objects of the simulated side"),
            column("n_matched", COUNT, "objects that both sides have"),
            column("n_missing", COUNT, "real objects without a simulated one"),
            column("n_hallucinated", COUNT, "simulated objects without a real one"),
            column("match_rate", REAL, "matched / max(communities of either side)"),
            *(
                column(f"{metric}_mean", REAL, f"mean of {metric} over the objects", optional=True)
                for metric in OBJECT_METRICS
            ),
        ]
    ),
    ("seed",),
)


def _pairs_schema() -> pa.Schema:
    """Columns of `pairs`: of a failed pair all but its name, status and reason may be null."""

    def count(name: str, meaning: str) -> pa.Field:
        return column(name, COUNT, meaning, optional=True)

    def real(name: str, meaning: str, unit: str = "") -> pa.Field:
        return column(name, REAL, meaning, unit, optional=True)

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
            PAIR.with_type(STRING),
            column("side", STRING, "real, sim, or null for a step of the pair", optional=True),
            column("stage", STRING, "ground, graph, communities, matching, selection, metrics, baselines or seeds"),
            column("step", STRING, "read, write, or a step of the method"),
            column("seconds", REAL, "wall time of the step", "s"),
            column("reused", FLAG, "the result was reused: the seconds are of the run that made it"),
        ]
    ),
    ("pair_id", "stage", "side", "step"),
)

#: All tables by name; the name is also the folder or file in a run.
TABLES = {
    table.name: table
    for table in (
        *(GROUND, GRAPH, COMMUNITIES, OBJECTS, MATCHING, SELECTION, METRICS, BASELINES, SEEDS, PAIRS, TIMINGS),
        *EXPERIMENT_TABLES,
    )
}
