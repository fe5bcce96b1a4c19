"""Causes that a few pairs of a dataset show, by the same estimates and the same rules as those of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.errors import StageError
from ...schemas.results import Cause, Unknown
from ...schemas.settings import Settings
from ...stages.arrays import FloatArray, transform_of
from ...stages.causes.estimates import Amount, estimate
from ...stages.causes.sides import PairScans, recorded_side
from ...stages.method import remove_road
from ...stages.pieces import CutScan
from ...stages.sensor_description import SensorDescription
from ...stages.statistics.comparison import blocks_of
from ..datasets.pairs import ScanPair
from ..datasets.readers.scan import Scan
from ..engine.pool import one_blas_thread
from ..results.causes import cause_values, named_causes, unknown_causes

#: Most pairs whose causes are estimated: each takes about a second.
MOST_PAIRS = 3


@dataclass(frozen=True)
class CauseCheck:
    """Causes of some pairs.

    pair_ids : pairs that were estimated
    causes : named ones; those that affect most of the surface first
    unknown : causes that cannot be estimated
    """

    pair_ids: tuple[str, ...] = ()
    causes: tuple[Cause, ...] = ()
    unknown: tuple[Unknown, ...] = ()


class CauseSamples:
    """Amounts of the causes of a few pairs.

    pair_ids : of which some are sampled, evenly
    """

    def __init__(self, pair_ids: Sequence[str], settings: Settings) -> None:
        n_sampled = min(len(pair_ids), MOST_PAIRS)
        rows = np.unique(np.linspace(0, len(pair_ids) - 1, n_sampled).round().astype(int))
        self.pair_ids = {pair_ids[row] for row in rows}
        self._settings = settings
        self._pairs: list[ScanPair] = []
        self._contents: list[str] = []
        self._amounts: list[dict[str, Amount]] = []

    def add(
        self,
        pair: ScanPair,
        scans: Mapping[str, Scan],
        sensors: Mapping[str, SensorDescription],
        content: str,
    ) -> None:
        """Add a pair; left out if its scans have too little in common.

        Parameters
        ----------
        content : hash of the real scan; copies count once
        """
        T_real_sim = transform_of(pair.T_real_sim)
        with one_blas_thread():
            try:
                estimates = estimate(self._pair_scans(scans, sensors, T_real_sim))
            except StageError:
                return
        if estimates is not None:
            self._pairs.append(pair)
            self._contents.append(content)
            self._amounts.append(estimates.amounts)

    def _pair_scans(
        self,
        scans: Mapping[str, Scan],
        sensors: Mapping[str, SensorDescription],
        T_real_sim: FloatArray | None,
    ) -> PairScans:
        real, real_cut = remove_road(scans["real"].points, self._settings, "real")
        sim, sim_cut = remove_road(
            scans["sim"].points,
            self._settings,
            "sim",
            T_real_sim=T_real_sim,
            real_cut=real_cut,
            real_points=real.points,
        )
        settings = self._settings.input
        position, voxel_m = settings.sensor_position, settings.voxel_m
        return PairScans(
            recorded_side(
                CutScan(real.points, real_cut.is_ground, real_cut.height_m),
                sensors["real"],
                None,
                position,
                voxel_m,
            ),
            recorded_side(
                CutScan(sim.points, sim_cut.is_ground, sim_cut.height_m),
                sensors["sim"],
                T_real_sim,
                position,
                voxel_m,
            ),
        )

    def named(self) -> CauseCheck:
        """The causes that the pairs show."""
        if not self._pairs:
            return CauseCheck()
        blocks = blocks_of(self._contents, [pair.timestamp_s for pair in self._pairs])
        values = cause_values(self._amounts)
        causes = tuple(named_causes(values, blocks))
        return CauseCheck(
            tuple(pair.pair_id for pair in self._pairs), causes, tuple(unknown_causes(values))
        )
