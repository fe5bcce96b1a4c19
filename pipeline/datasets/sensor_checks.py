"""Which sensors the two sides of a dataset are from, as a few of its scans tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError
from ...schemas.settings import InputSettings
from ...stages.clean import as_ros
from ...stages.sensing.sensor import SensorFacts, describe_sensor, differences
from .pairs import ScanPair
from .readers import read_scan

_PAIRS = 2


@dataclass(frozen=True)
class SensorCheck:
    """What sensors the sides are from.

    pair_ids : whose scans were looked at
    sides : by side, what the scan with the most telling beams shows; a side none of whose files can be read has none
    differences : one sentence for each thing in which the sides differ
    """

    pair_ids: tuple[str, ...]
    sides: dict[str, SensorFacts]
    differences: list[str]


def describe_sides(pairs: Sequence[ScanPair], settings: InputSettings) -> SensorCheck:
    """What sensors the sides are from, by the scans of the first two pairs as they lie in their files.

    Nothing is cleaned or moved, axes alone are turned: beams are those of a sensor only in its own frame. Of the two
    scans of a side the one tells whose model is known, or else whose beams are.
    """
    looked_at = pairs[:_PAIRS]
    sides = {}
    for side in SIDES:
        told = [facts for pair in looked_at if (facts := _describe(pair, side, settings))]
        if told:
            sides[side] = max(told, key=lambda facts: (facts.model is not None, bool(facts.is_sharp), facts.n_points))
    found = differences(sides["real"], sides["sim"]) if len(sides) == len(SIDES) else []
    return SensorCheck(tuple(pair.pair_id for pair in looked_at), sides, found)


def _describe(pair: ScanPair, side: str, settings: InputSettings) -> SensorFacts | None:
    path = pair.path(side)
    if path is None:
        return None
    try:
        scan = read_scan(path, settings.columns_of(side))
    except (FidpipeError, OSError):
        return None  # a fault, which the check of the files names
    return describe_sensor(as_ros(scan.points, settings.frame_of(side)), scan.rings, scan.times_s is not None)
