"""The argument of a job: what its stage declares, for a run and in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pyarrow as pa

from ...schemas.settings import Settings
from ..datasets.readers.scan import Scan
from ..stage import Inputs, Metadata
from ..storage.table_files import JobId
from .plan import Job, Source


def declared_inputs(
    job: Job,
    read_table: Callable[[Source], pa.Table],
    read_scan: Callable[[str], Scan],
    outputs: Mapping[JobId, Metadata],
    T_real_sim: tuple[float, ...] | None,
    **others: Any,
) -> Inputs:
    """The inputs of a job that its stage declares; tables and scans are read when first requested.

    Parameters
    ----------
    read_table, read_scan : return the declared columns of a table, and the scan of a side
    outputs : metadata of finished jobs; of a job that is done object by object there are none yet
    T_real_sim : of the pair; for jobs that take the simulated scan
    others : fields of `Inputs`
    """
    tables: dict[tuple[str, str], Callable[[], pa.Table]] = {}
    scans: dict[str, Callable[[], Scan]] = {}
    metadata: dict[tuple[str, str], Metadata] = {}
    for source in job.sources:
        name = source.table, source.side
        if source.maker is None:
            scans[source.side] = partial(read_scan, source.side)
            continue
        if source.columns:
            tables[name] = partial(read_table, source)
        if source.maker in outputs:
            metadata[name] = outputs[source.maker]
    groups = {group: getattr(job.settings, group) for group in job.stage.settings}
    return Inputs(
        part=job.part,
        settings=cast(Settings, SimpleNamespace(**groups)),
        tables=tables,
        outputs=metadata,
        scans=scans,
        T_real_sim=T_real_sim if "sim" in scans else None,
        arguments=job.stage.arguments,
        **others,
    )
