"""Toy stages, one of each grain, with their own tables and settings; a module that worker processes can import."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import BaseModel, ConfigDict

from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.jobs.points_job import column as values_of
from fidpipe.pipeline.stage import Grain, JobResult, Stage
from fidpipe.schemas.columns import SIDES, Table, column
from fidpipe.schemas.settings import Settings
from fidpipe.schemas.tables import TABLES

PAIR = column("pair_id", pa.string(), "name of the scan pair")
SIDE = column("side", pa.string(), "real or sim")
COMMUNITY = column("community_id", pa.int32(), "object of this side")
REAL_ID = column("real_id", pa.int32(), "community of the real side")

CROWDS = Table(
    "toy_crowds",
    pa.schema(
        [PAIR, SIDE, COMMUNITY, column("n_over", pa.int32(), "points over toy.least_points")]
    ),
    ("community_id",),
)
RATIOS = Table(
    "toy_ratios",
    pa.schema([PAIR, REAL_ID, column("ratio", pa.float64(), "of simulated points")]),
    ("real_id",),
)
MARKS = Table(
    "toy_marks",
    pa.schema([PAIR, REAL_ID, column("mark", pa.float64(), "cdc times ratio")]),
    ("real_id",),
)
TOY_TABLES = (CROWDS, RATIOS, MARKS)
TABLES.update({table.name: table for table in TOY_TABLES})


class ToyGroup(BaseModel):
    """Settings of the toys."""

    model_config = ConfigDict(frozen=True)
    least_points: int = 20


class ToySettings(Settings):
    """All settings, with a group for the toys."""

    toy: ToyGroup = ToyGroup()


def make_crowds(inputs):
    """Points of each community beyond a number, for one side."""
    n_points = np.bincount(values_of(inputs.table("communities", inputs.part), "community_id"))
    n_over = np.maximum(n_points - inputs.settings.toy.least_points, 0).astype(np.int32)
    ids = np.arange(len(n_over), dtype=np.int32)
    rows = {
        "pair_id": inputs.pair_id,
        "side": inputs.part,
        "community_id": ids,
        "n_over": n_over,
    }
    return JobResult(
        {"toy_crowds": CROWDS.build(rows)}, {"n_crowds": int(np.count_nonzero(n_over))}
    )


def make_ratios(inputs):
    """Ratio of simulated to real points of each object."""
    n_over = {side: values_of(inputs.table("toy_crowds", side), "n_over") for side in SIDES}
    rows = []
    for match in inputs.table("matching").select(MATCHED).to_pylist():
        real_id = match["real_id"]
        sim_id = match["sim_id"]
        if real_id is not None and sim_id is not None:
            ratio = n_over["sim"][sim_id] / (1 + n_over["real"][real_id])
            rows.append({"pair_id": inputs.pair_id, "real_id": real_id, "ratio": ratio})
    facts = {side: inputs.metadata("toy_crowds", side)["n_crowds"] for side in SIDES}
    return JobResult(
        {"toy_ratios": RATIOS.from_rows(rows)},
        facts | {"n_kept": inputs.table("selection").num_rows},
    )


def make_marks(inputs):
    """A mark for each object, from its scores and the table of the pair."""
    ratio_of = inputs.memo(ratios, inputs.table("toy_ratios"))
    metrics = inputs.table("metrics")
    own = metrics.filter(
        pc.is_in(metrics.column("real_id"), pa.array(inputs.objects, pa.int32()))
    )
    rows = [
        {
            "pair_id": inputs.pair_id,
            "real_id": row["real_id"],
            "mark": row["cdc"] * ratio_of[row["real_id"]],
        }
        for row in own.to_pylist()
    ]
    return JobResult({"toy_marks": MARKS.from_rows(rows)})


def ratios(table):
    """The ratio of each object."""
    return dict(zip(*(table.column(name).to_pylist() for name in RATIO), strict=True))


def gather_marks(inputs, tables):
    """The best mark of the pair."""
    marks = tables["toy_marks"].column("mark").to_pylist()
    return {"best": min(marks, default=None), "n_crowds": inputs.metadata("toy_ratios")["real"]}


MATCHED = ("real_id", "sim_id")
RATIO = ("real_id", "ratio")
OF_SIDE = Stage(
    name="crowds",
    takes=("communities",),
    gives=("toy_crowds",),
    settings=("toy",),
    grain=Grain.SIDE,
    make=make_crowds,
)
OF_PAIR = Stage(
    name="ratios",
    takes=("toy_crowds", "matching", "selection"),
    gives=("toy_ratios",),
    grain=Grain.PAIR,
    make=make_ratios,
)
OF_OBJECT = Stage(
    name="marks",
    takes=("toy_ratios", "metrics"),
    gives=("toy_marks",),
    grain=Grain.OBJECT,
    make=make_marks,
    gather=gather_marks,
)

N_BEFORE_MATCHING = next(i for i, stage in enumerate(STAGES) if stage.grain is not Grain.SIDE)


def with_toys(of_side=OF_SIDE, of_pair=OF_PAIR, of_object=OF_OBJECT):
    """The pipeline with a toy of the sides before matching, and a toy of the pair and one of its objects at the end."""
    return (
        *STAGES[:N_BEFORE_MATCHING],
        of_side,
        *STAGES[N_BEFORE_MATCHING:],
        of_pair,
        of_object,
    )
