"""Catalogue of causes: named flaws of a simulator, from `causes.toml`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from .data_files import read_data

#: Parameters of a displacement, in their order: metres, degrees, share, metres, metres and degrees per sweep, metres.
PARAMETERS = (
    *("forward", "sideways", "height", "roll", "pitch", "yaw", "range scale", "range bias"),
    *("motion forward", "motion sideways", "motion turning", "road height"),
)
#: Amount that is not a cause: variance of the share of returns between directions, beyond that of counting and of the
#: fit of the losses; at most 0 if they are lost at random.
UNEVEN = "unevenness of returns"
#: Share of curved real surface where the simulated surface is much flatter.
FLAT = "flat shapes"
#: Relative accuracy of the surface distance of a second measurement.
BEST_CASE_ACCURACY = 0.2
#: Causes that lose a share of the returns: over another run, of what that one returns.
LOSSES = ("lost returns", "lost far returns", "lost grazing returns")


@dataclass(frozen=True)
class CauseModel:
    """A flaw of the catalogue.

    kind : "sensor" for a property of the sensor or its pose, the same in all scans; "world" for what differs from place
        to place
    tolerance : it is named beyond this: the difference of two measurements of a scene, and for positions what a poor
        twin shows without being displaced
    resolution : larger than any estimate without the flaw; a change between two runs is named beyond it
    relative : further error of the estimate, per amount; it widens the interval, and has no influence on what is named
    words : with {size}, above 0, and below 0 unless the flaw has one direction
    setting : what controls it, attributes of CARLA's blueprint where they fit
    limbs : identifiers of PerCollECT's LidarLimbs cause tree (`data.json`, MIT) that fit
    needs : what must be known of both sides, see `stages/trust.py`; else its amount is unknown
    is_restored : it is corrected by adding real points, so that the gain is an upper bound
    """

    name: str
    kind: str
    unit: str
    tolerance: float
    resolution: float
    words: tuple[str, ...]
    setting: str
    relative: float = 0.0
    limbs: tuple[int, ...] = ()
    needs: tuple[str, ...] = ()
    is_restored: bool = False


def _read_causes() -> Iterator[CauseModel]:
    for name, values in read_data("causes").items():
        lists = {key: tuple(value) for key, value in values.items() if isinstance(value, list)}
        yield CauseModel(name, **{**values, **lists})


#: Causes by name, the displacements (`PARAMETERS`) first.
CAUSES = {cause.name: cause for cause in _read_causes()}
