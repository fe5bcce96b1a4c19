"""The task of `fidpipe ablate`: one pair under one setting of the graph, and all of matching and selection on it."""

from __future__ import annotations

from ...schemas.experiment_tables import ABLATE
from ...schemas.metrics import OBJECT_METRICS
from ...schemas.settings import Settings
from ...stages.method import Memo, compare, n_communities, partition
from ..jobs import seeds
from ..jobs.points import ANNOTATED_COLUMNS, annotation, object_points
from ..stage import Grain, Inputs, JobResult, Stage

_SUMMARY = ("n_matched", "match_rate", *(f"{metric}_mean" for metric in OBJECT_METRICS))


def make_rows(own: Inputs) -> JobResult:
    """One row of `ablate` per point (k, tau, delta, t) of the arguments, which have k and tau of the settings.

    The graphs and communities of both sides are made once, an object that is matched under several delta is scored
    once for each t.
    """
    declared = own.settings
    (points,) = own.arguments
    real = partition(object_points(own, "real")[1], declared, annotation=annotation(own, "real"))
    sim = partition(object_points(own, "sim")[1], declared, reference=real.reference)
    memo: Memo = {}
    rows = []
    for k, tau_m, delta_m, t in points:
        settings = Settings(
            communities=declared.communities,
            matching=declared.matching.model_copy(update={"delta_m": delta_m}),
            selection=declared.selection.model_copy(update={"t": t}),
        )
        summary = compare(real, sim, settings, memo=memo).summary
        rows.append(
            {"pair_id": own.pair_id, "k": k, "tau_m": tau_m, "delta_m": delta_m, "t": t}
            | n_communities(summary)
            | {name: summary[name] for name in _SUMMARY}
        )
    return JobResult({"ablate": ABLATE.from_rows(rows)})


#: Its version is to be raised when the same request gives other numbers.
STAGE = Stage(
    name="ablate",
    takes={"ground": ANNOTATED_COLUMNS},
    gives=("ablate",),
    settings=("graph", "communities", "matching", "pieces", "selection"),
    grain=Grain.PAIR,
    version=2,
    make=make_rows,
    libraries=seeds.STAGE.libraries,
)
