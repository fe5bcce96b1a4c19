"""Names of the numbers of a finished run, in criteria and in the shell; imports no library."""

from __future__ import annotations

from ...schemas.cause_catalogue import CAUSES, UNEVEN
from ...schemas.data_files import read_rows
from ...schemas.metric_catalogue import (
    COVERAGE_SCORES,
    DISTRIBUTED,
    OBJECT_METRICS,
    PIECE_SCORES,
    RAY_MEANS,
    SURFACE_SCORES,
)

OF_PAIRS = ("mean", "std", "min", "median", "max")
OF_OBJECTS = ("mean", "std", "min", "q05", "q25", "median", "q75", "q95", "max")
COUNTS = ("total", "mean", "max", "share")
PAIR_SCORES = (
    "match_rate",
    *OBJECT_METRICS,
    *(metric.column for metric in (*SURFACE_SCORES, *PIECE_SCORES)),
)
#: Names by which a gate knows other columns: `covered.real.0.3m` is `covered_real_0p3m`, `rays.bias_m` `rays_bias_m`.
DOTTED = {
    **{
        metric.column.replace("_", ".").replace("p", "."): metric.column
        for metric in COVERAGE_SCORES
    },
    **{column.replace("rays_", "rays."): column for column in RAY_MEANS},
}
#: Estimated properties of both sensors: `sensor.sim.range_noise_m` is the column `sensor_sim_range_noise_m`.
SENSOR_VALUES = {
    row["column"].replace("_", ".", 2): row["column"]
    for row in read_rows("tables")
    if row["table"] == "pairs" and row["column"].startswith("sensor_")
}
#: Of the double validation metric, over objects where a score has them.
OF_DISTRIBUTIONS = ("bias", "area")

STATES = ("scored", "failed", "to_do", "changed", "frame_suspect")

#: Measures of tasks: `tasks.objects.lost` is the mean of their gap, `tasks.objects.lost.max` its largest value.
TASK_MEASURES = (
    *("objects.lost", "objects.added", "objects.size_m", "objects.place_m"),
    *("ground.disagreement", "ground.height_m"),
    *("occupancy.mismatch", "occupancy.wrongly_free", "occupancy.wrongly_occupied"),
    *("free_space.distance_m", "free_space.too_far"),
)
#: Measures of odometry: `tasks.odometry.drift_m` is the gap over the longest sequence of scans.
ODOMETRY_MEASURES = ("drift_m", "step_m", "turn_deg")

#: Names of causes by that of the catalogue.
CAUSE_NAMES = {name.replace(" ", "_"): name for name in CAUSES if name != UNEVEN}
#: Ends of the 95 % interval of a cause.
INTERVAL_ENDS = ("low", "high")

#: The names that stand for themselves, to guess what a wrong one means.
PLAIN_NAMES = (
    *(f"{value}.{stat}" for value in (*PAIR_SCORES, *DOTTED, *SENSOR_VALUES) for stat in OF_PAIRS),
    *(f"objects.{score}.{stat}" for score in DISTRIBUTED for stat in OF_OBJECTS),
    *(f"{what}.{count}" for what in ("not_found", "extra") for count in (*COUNTS, "within_20m")),
    *(f"matched.{count}" for count in ("total", "mean", "min")),
    *(f"pairs.{state}" for state in STATES),
    *(f"causes.{name}" for name in CAUSE_NAMES),
    *(f"tasks.{measure}" for measure in TASK_MEASURES),
    *(f"tasks.odometry.{measure}" for measure in ODOMETRY_MEASURES),
    *(
        f"excess.{score}.{stat}"
        for score in (*PAIR_SCORES, *DOTTED)
        for stat in (*OF_PAIRS, *OF_DISTRIBUTIONS)
    ),
)
