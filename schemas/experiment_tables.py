"""The tables of `fidpipe perturb` and `fidpipe ablate`."""

from __future__ import annotations

import pyarrow as pa

from .columns import FLOAT64, INT32, PAIR, STRING, column, mean_columns, table
from .metric_catalogue import OBJECT_METRICS

_LEVEL = [
    column("kind", STRING, "perturbation: null, noise, dropout, rigid, hallucination or density"),
    column("amount", FLOAT64, "noise: m; dropout, hallucination: share of the points; rigid: degrees; density: factor"),
    column("shift_m", FLOAT64, "rigid: length of the translation; else 0", "m"),
]
_REPEAT = [
    column("repeat", INT32, "number of the repetition, from 0"),
    column("seed", pa.int64(), "random seed of this repetition, derived from the job's name"),
]
_UNDER_TEST = [
    PAIR.with_type(STRING),
    column("community_id", INT32, "object of the unaltered scan"),
    column("object", STRING, "class of the object: its label or its shape, or its number"),
]

_SPREAD = [
    column("mean", FLOAT64, "mean over these values", optional=True),
    column("std", FLOAT64, "standard deviation (n - 1) over these values", optional=True),
]

PERTURB_GLOBAL = table(
    "perturb_global",
    ("pair_id", "kind", "shift_m", "amount", "repeat"),
    PAIR.with_type(STRING),
    *_LEVEL,
    *_REPEAT,
    column("n_points", INT32, "object points of the unaltered scan"),
    column("n_points_altered", INT32, "object points of the altered scan"),
    column("n_communities", INT32, "objects of the unaltered scan"),
    column("n_communities_altered", INT32, "objects of the altered scan", optional=True),
    column("n_matched", INT32, "objects that both scans have", optional=True),
    column("n_identical", INT32, "matched objects with equal Laplacians", optional=True),
    column("n_too_small", INT32, "matched objects with fewer than 3 nodes", optional=True),
    column("match_rate", FLOAT64, "matched / max(communities of either scan)", optional=True),
    *mean_columns("matched objects"),
    column("reason", STRING, "why nothing could be computed", optional=True),
)

PERTURB_OBJECTS = table(
    "perturb_objects",
    ("pair_id", "community_id", "kind", "shift_m", "amount", "repeat"),
    *_UNDER_TEST,
    *_LEVEL,
    *_REPEAT,
    column("n_points", INT32, "points of the unaltered object"),
    column("n_points_altered", INT32, "points of the altered object"),
    *(
        column(name, FLOAT64, "score of the altered against the unaltered object, as in metrics", optional=True)
        for name in OBJECT_METRICS
    ),
    column("status", STRING, "scored, identical or too_small"),
    column("reason", STRING, "why a score is null", optional=True),
)

PERTURB_BASELINES = table(
    "perturb_baselines",
    ("pair_id", "community_id", "kind", "shift_m", "amount", "repeat", "baseline"),
    *_UNDER_TEST,
    *_LEVEL,
    *_REPEAT,
    column("baseline", STRING, "name of the baseline metric, with its convention and unit, as in baselines"),
    column("unit", STRING, "unit of the value; null for a plain number", optional=True),
    column("value", FLOAT64, "baseline metric of the altered against the unaltered object", optional=True),
    column("reason", STRING, "why the value is null, or a note about it", optional=True),
)

PERTURB_SUMMARY = table(
    "perturb_summary",
    ("scope", "object", "kind", "shift_m", "amount", "metric"),
    column("scope", STRING, "global (whole scan) or object"),
    column("object", STRING, "class of the object; null if the scope is global", optional=True),
    *_LEVEL,
    column("metric", STRING, "column of perturb_global or perturb_objects, or baseline of perturb_baselines"),
    column("n", INT32, "repetitions, over all scans, in which the metric could be computed"),
    *_SPREAD,
)

_ABLATED = [
    column("k", INT32, "graph.k"),
    column("tau_m", FLOAT64, "graph.tau_m", "m"),
    column("delta_m", FLOAT64, "matching.delta_m", "m"),
    column("t", FLOAT64, "selection.t"),
]

ABLATE = table(
    "ablate",
    ("pair_id", "k", "tau_m", "delta_m", "t"),
    PAIR.with_type(STRING),
    *_ABLATED,
    column("n_communities_real", INT32, "objects of the real side"),
    column("n_communities_sim", INT32, "objects of the simulated side"),
    column("n_matched", INT32, "objects that both sides have"),
    column("match_rate", FLOAT64, "matched / max(communities of either side)"),
    *mean_columns("matched objects"),
)

ABLATE_SUMMARY = table(
    "ablate_summary",
    ("k", "tau_m", "delta_m", "t", "metric"),
    *_ABLATED,
    column("metric", STRING, "column of ablate"),
    column("n_pairs", INT32, "pairs in which the metric could be computed"),
    *_SPREAD,
)

EXPERIMENT_TABLES = (PERTURB_GLOBAL, PERTURB_OBJECTS, PERTURB_BASELINES, PERTURB_SUMMARY, ABLATE, ABLATE_SUMMARY)
