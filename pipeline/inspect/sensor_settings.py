"""Settings of the simulated sensor, as the user made them, compared with what its scans show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partialmethod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from ...schemas.data_files import parse_toml, read_data
from ...schemas.errors import FidpipeError, suggestion
from ...stages.arrays import FloatArray
from ...stages.sensor_description import HOLE, LOST_BANDS_M, SensorDescription
from ..datasets.readers.scan import cause_of

AS_SET, DIFFERS, NOT_CHECKED = "as set", "differs", "not checked"
_IGNORED = 0.25  # a simulator that shows less than this share of a setting ignores it
_FARTHER = 50  # real returns per scan beyond the simulated ones, from which these end too early
#: Values of a CARLA blueprint, for attributes that the file does not name.
_CARLA = {"dropoff_intensity_limit": 0.8, "atmosphere_attenuation_rate": 0.004}
#: Unit, and estimate or reason why it is not checked, by setting.
_SETTINGS = read_data("sensor_settings")
#: Entries of such files that describe the sensor and set nothing.
_DESCRIPTIVE = ("role_name", "type", "id", "name", "title", "source", "unit_deg", "focal_m", "column_deg")


@dataclass(frozen=True)
class SettingCheck:
    """A setting of the simulated sensor, and its estimate from the scans.

    seen, uncertainty : estimate and half of its interval; None if not checked
    verdict : "as set", "differs" or "not checked"
    note : cause of a difference, or reason why it is not checked
    """

    name: str
    value: float | tuple[float, ...]
    unit: str = ""
    seen: float | None = None
    uncertainty: float | None = None
    verdict: str = NOT_CHECKED
    note: str = ""

    @property
    def text(self) -> str:
        """One line for the terminal."""
        value = f"{len(self.value)} values" if isinstance(self.value, tuple) else _text(self.value)
        unit = f" {self.unit}" * bool(self.unit)
        spread = f" ± {self.uncertainty:.2g}" if self.uncertainty else ""
        seen = "" if self.seen is None else f", seen {_text(self.seen)}{spread}{unit}"
        return f"{self.name} set {value}{unit}{seen}" + (f": {self.note}" if self.note else "")


@dataclass(frozen=True)
class SensorEvidence:
    """Measurements of the simulated sensor from sampled scans, and estimates of its settings from them.

    Each estimate takes the value of its setting, and all settings.

    sensors : one for each simulated scan; usual : the most frequent of them
    ranges_m : by side, ranges of the returns of each scan
    intensity : intensities of a simulated scan with the ranges of its points, or None
    revolution_s : from the times of points, or None
    """

    sensors: Sequence[SensorDescription]
    usual: SensorDescription | None
    ranges_m: Mapping[str, Sequence[FloatArray]]
    intensity: tuple[FloatArray, FloatArray] | None
    revolution_s: float | None

    def of_sensors(self, name: str, accuracy: Callable[[float], float]) -> _Estimate:
        """Estimate of an attribute of the sensor descriptions."""
        sensors = self.sensors
        why = next((own.untold[name] for own in sensors if name in own.untold), "no simulated scan can be read")
        return _over_scans([getattr(own, name) for own in sensors], accuracy, why)

    def azimuth_step(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Angle between two firings."""
        return self.of_sensors("azimuth_step_deg", lambda seen: 0.03 * seen)

    def quantum(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Range steps; 0 if no quantum fits."""
        found = self.of_sensors("range_quantum_m", lambda seen: 0.01 * seen)
        return _Estimate(0.0, 0.0005) if found.seen is None and found.note.startswith("no quantum") else found

    def noise(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Range noise; surfaces that are not smooth can only add to it."""
        found = self.of_sensors("range_noise_m", lambda seen: 0.003 + 0.2 * seen)
        return found._replace(excess=0.01 + 0.5 * value)

    def near_lost(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Lost share in the nearest band of range, where intensity is highest.

        Gaps of more than `HOLE` pulses are not counted, so that the share is that of a truncated
        geometric distribution.
        """
        true = np.linspace(0.0, 0.9, 901)
        longest = HOLE + 1
        mean_firings = 1 / (1 - true) - longest * true**longest / (1 - true**longest)
        nearest = [next((share for share in own.lost_share if share is not None), None) for own in self.sensors]
        shares = [None if own is None else float(np.interp(own, 1 - 1 / mean_firings, true)) for own in nearest]
        found = _over_scans(shares, lambda seen: 0.02, "too few returns of one surface")
        return found._replace(excess=0.05 if "signal_range_m" in settings else 0.0)  # weak returns are lost too

    def far_lost(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """CARLA drops a point of intensity I = exp(-a r) below the limit L with the probability z (1 - I / L)."""
        limit, rate = (float(settings.get(name, usual)) for name, usual in _CARLA.items())
        range_m = np.geomspace(*LOST_BANDS_M[-2:], 50)
        share = float(np.maximum(1 - np.exp(-rate * range_m) / limit, 0).mean()) if limit > 0 else 0.0
        if share < 0.05:
            return _Estimate(None, note=f"intensity is hardly below the limit within {LOST_BANDS_M[-1]:g} m")
        bands = [own.lost_share for own in self.sensors if own.lost_share and None not in own.lost_share]
        excess = [(1 - (1 - own[-1]) / (1 - own[0])) / share for own in bands]  # type: ignore[operator]
        return _over_scans(excess, lambda seen: 0.05 / share, f"too few returns beyond {LOST_BANDS_M[-2]:g} m")

    def attenuation(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Rate at which intensity falls with range."""
        if self.intensity is None:
            return _Estimate(None, note="the simulated scans have no intensity")
        intensity, range_m = self.intensity
        is_used = (intensity > 0) & (intensity < 1) & (range_m > 5)
        if is_used.sum() < 100:
            return _Estimate(None, note="too few intensities between 0 and 1")
        low, rate, high = np.quantile(-np.log(intensity[is_used]) / range_m[is_used], (0.1, 0.5, 0.9)).tolist()
        if high - low > 0.2 * rate:
            return _Estimate(None, note="intensity does not fall exponentially with range")
        return _Estimate(rate, 0.05 * rate)

    def beams(self, value: Any, settings: Mapping[str, Any]) -> _Estimate:
        """Number of beams; those without a return count if the spacing of the others is that of all."""
        sensor = self.usual
        if sensor is None or len(sensor.elevation_deg) < 2:
            return _Estimate(
                None, note=sensor.untold.get("elevation_deg", "one beam") if sensor else "no scan can be read"
            )
        n, n_set = len(sensor.elevation_deg), len(value) if isinstance(value, tuple) else round(value)
        lower = settings.get("lower_fov", settings.get("lower_deg"))
        upper = settings.get("upper_fov", settings.get("upper_deg"))
        if lower is not None and upper is not None and n < n_set and sensor.is_even:
            by_spacing = (upper - lower) / float(np.median(np.diff(sensor.elevation_deg))) + 1
            return _Estimate(float(round(by_spacing)), 0.0 if sensor.is_sharp else 0.1 * n_set)
        if n_set / 2 < n < n_set:
            return _Estimate(float(n), note="beams without a return are not seen", is_bound=True)
        return _Estimate(float(n), 0.0 if sensor.is_sharp and (sensor.is_even or sensor.model) else 0.1 * n_set)

    def _limit(self, value: float, settings: Mapping[str, Any], *, is_upper: bool) -> _Estimate:
        """Highest or lowest beam; a beam beyond it may have no return if the spacing of the beams allows it."""
        sensor = self.usual
        if sensor is None or len(sensor.elevation_deg) < 2:
            return self.beams(1, settings)
        limits = [own.elevation_deg[-1 if is_upper else 0] for own in self.sensors if own.elevation_deg]
        found = _over_scans(limits, lambda seen: 0.3 if sensor.is_sharp else 1.0, "no beams detected")
        seen = found.seen or 0.0
        inside = (value - seen) if is_upper else (seen - value)
        spacing = float(np.median(np.diff(sensor.elevation_deg)))
        if inside > 0.3 and (not sensor.is_even or abs(inside / spacing - round(inside / spacing)) < 0.3):
            return _Estimate(seen, note="beams beyond may have no return", is_bound=True)
        return found

    upper, lower = partialmethod(_limit, is_upper=True), partialmethod(_limit, is_upper=False)

    def farthest(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Farthest returns."""
        if not self.ranges_m["sim"]:
            return _Estimate(None, note="no simulated scan can be read")
        seen = max(float(np.quantile(own, 0.9999)) for own in self.ranges_m["sim"])
        noise = float(settings.get("noise_stddev", settings.get("range_noise_m", 0.0)))
        if seen >= 0.95 * value:
            return _Estimate(seen, 0.05 * value + 4 * noise)
        n_farther = [np.count_nonzero(own > 1.1 * seen) for own in self.ranges_m["real"]]
        if n_farther and np.median(n_farther) >= _FARTHER:
            return _Estimate(seen, 0.0, f"real scans have {np.median(n_farther):.0f} returns farther away")
        return _Estimate(seen, note="there may be no surface farther away", is_bound=True)

    def nearest(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Nearest returns."""
        if not self.ranges_m["sim"]:
            return _Estimate(None, note="no simulated scan can be read")
        seen = min(float(np.quantile(own, 0.0001)) for own in self.ranges_m["sim"])
        is_inside = seen > value
        return _Estimate(seen, 0.1, "there may be no surface nearer" if is_inside else "", is_bound=is_inside)

    def rotation(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Revolutions per second."""
        if not self.revolution_s:
            return _Estimate(None, note="the simulated points have no times")
        return _Estimate(1 / self.revolution_s, 0.1 / self.revolution_s)

    def points_rate(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Firings of all beams in a second, from the azimuth step and the other settings."""
        if not {"channels", "rotation_frequency"} <= settings.keys():
            return _Estimate(None, note="the file has no channels and rotation_frequency")
        found = self.of_sensors("azimuth_step_deg", lambda seen: 0.02 * seen)
        if found.seen is None:
            return found
        rate = (
            settings["rotation_frequency"] * settings.get("horizontal_fov", 360.0) * settings["channels"] / found.seen
        )
        return _Estimate(rate, rate * found.accuracy / found.seen)

    def sector(self, value: float, settings: Mapping[str, Any]) -> _Estimate:
        """Sector of azimuth that has returns."""
        views = [own.field_of_view_deg[2] if own.field_of_view_deg else None for own in self.sensors]
        return _over_scans(views, lambda seen: 10.0, "no simulated scan can be read")


class _Estimate(NamedTuple):
    """Estimate of a setting.

    seen : None if unknown
    accuracy : half of its interval
    note : reason if unknown, or cause of a difference
    is_bound : a setting beyond it is not contradicted
    excess : by which the scans may exceed the setting for other reasons
    """

    seen: float | None
    accuracy: float = 0.0
    note: str = ""
    is_bound: bool = False
    excess: float = 0.0


def read_sensor_settings(path: Path) -> dict[str, Any]:
    """Settings of a TOML or JSON file: attributes of CARLA's LiDAR blueprint, or those of a sensor of `fidpipe twin`.

    Numbers may be text, as `set_attribute` takes them. Of a file with a table `sensor`, such as `twin.toml`, that table
    is read.

    Raises
    ------
    FidpipeError
        The file cannot be read, has an unknown setting, or a value that is not a number.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = orjson.loads(text) if path.suffix.lower() == ".json" else parse_toml(text)
    except OSError as error:
        raise FidpipeError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise FidpipeError(f"{path}: expected settings in TOML or JSON ({cause_of(error)})") from error
    values = values.get("sensor", values) if isinstance(values, dict) else values
    if not isinstance(values, dict) or not values:
        raise FidpipeError(f"{path}: expected a table of settings of the simulated sensor")
    known = (*_SETTINGS, *_DESCRIPTIVE)
    for name in values:
        if name not in known:
            raise FidpipeError(f"{path}: unknown setting {cause_of(name)}; {suggestion(name, known)}")
    is_recorded = values.get("elevation_deg") == []  # a twin's rays are those of its recording
    unset = {*_DESCRIPTIVE, *(("elevation_deg", "azimuth_offset_deg", "azimuth_step_deg") * is_recorded)}
    return {name: _value(path, name, value) for name, value in values.items() if name not in unset}


def check_sensor_settings(settings: Mapping[str, Any], evidence: SensorEvidence) -> list[SettingCheck]:
    """Compare each setting with its estimate; they differ if the setting is outside of the estimate's interval.

    The interval is twice the standard error over the scans plus the accuracy of the estimator.

    Parameters
    ----------
    settings : see `read_sensor_settings`
    """
    checks = []
    for name, value in settings.items():
        own = _SETTINGS[name]
        unit = own.get("unit", "")
        found = (
            _Estimate(None, note=own["note"]) if "note" in own else getattr(evidence, own["estimate"])(value, settings)
        )
        if found.seen is None or (found.is_bound and found.note):
            checks.append(SettingCheck(name, value, unit, found.seen, note=found.note))
            continue
        target = float(len(value)) if isinstance(value, tuple) else float(value)
        differs = not -max(found.accuracy, found.excess) <= target - found.seen <= found.accuracy
        note = found.note
        if differs and not note and abs(found.seen) < _IGNORED * abs(target):
            note = "the simulator ignores it"
        verdict = DIFFERS if differs else AS_SET
        checks.append(SettingCheck(name, value, unit, found.seen, found.accuracy, verdict, note if differs else ""))
    return checks


def _value(path: Path, name: str, value: Any) -> Any:
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.array(np.nan)
    is_list = name in ("elevation_deg", "azimuth_offset_deg")
    if isinstance(value, bool) or numbers.ndim != is_list or not np.isfinite(numbers).all():
        kind = "a list of numbers" if is_list else "a number"
        raise FidpipeError(f"{path}: {name}: expected {kind}, got {cause_of(repr(value))}")
    low, high = _SETTINGS[name].get("range", (-np.inf, np.inf))
    if (numbers < low).any() or (numbers > high).any():
        bounds = f"from {low:g} to {high:g}" if np.isfinite(high) else f"of at least {low:g}"
        raise FidpipeError(f"{path}: {name}: expected a number {bounds}, got {cause_of(repr(value))}")
    if name == "channels" and numbers % 1:
        raise FidpipeError(f"{path}: {name}: expected a whole number, got {cause_of(repr(value))}")
    return tuple(numbers.tolist()) if is_list else float(numbers)


def _text(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _over_scans(values: Sequence[float | None], accuracy: Callable[[float], float], why: str) -> _Estimate:
    """Median over the scans that have the value, or the reason."""
    known = np.array([value for value in values if value is not None])
    if not len(known):
        return _Estimate(None, note=why)
    error = 2 * float(known.std(ddof=1)) / len(known) ** 0.5 if len(known) > 1 else 0.0
    seen = float(np.median(known))
    return _Estimate(seen, accuracy(seen) + error)
