"""Sensor models by name or from a table of beams."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.errors import FidpipeError, suggestion
from ...schemas.sensor_models import SENSORS, SensorModel
from ...schemas.settings import parse_toml
from ...stages.generate.rescan import RECORDED
from ..datasets.readers.scan import cause_of

_TABLES = (".csv", ".toml")
_ANGLES = ("elevation_deg", "azimuth_offset_deg")
_UNIFORM = ("channels", "upper_deg", "lower_deg")
_BOUNDS = {"azimuth_step_deg": (0.01, 10.0), "lost_share": (0.0, 1.0)}
#: Defaults of values that a table may omit.
_DEFAULTS = replace(SENSORS["hdl64"], name="table", title="", source="", azimuth_step_deg=0.2, range_quantum_m=0.0)
_NUMBERS = tuple(
    field.name
    for field in fields(SensorModel)
    if field.name not in ("name", "title", "source", "unit_deg", "focal_m", *_ANGLES)
)


def read_sensor(name: str) -> SensorModel:
    """The sensor of a name in `SENSORS`, `RECORDED`, or the sensor described by a table.

    A `.csv` has a column elevation_deg and optionally azimuth_offset_deg, one row per laser. A `.toml` has
    elevation_deg (and azimuth_offset_deg) as lists, or channels, upper_deg and lower_deg for uniform ones; and
    optionally azimuth_step_deg, min_range_m, max_range_m, range_noise_m, range_quantum_m, lost_share.

    Raises
    ------
    FidpipeError
        No such sensor or file exists, or the file has another content.
    """
    known = {RECORDED.name: RECORDED, **SENSORS}
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix.lower() not in _TABLES:
        raise FidpipeError(f"sensor {name!r}: no such sensor; {suggestion(name, [*known, 'a table (.csv, .toml)'])}")
    try:
        text = path.read_text(encoding="utf-8")
        values = parse_toml(text) if path.suffix.lower() == ".toml" else _columns(text)
    except OSError as error:
        raise FidpipeError(f"sensor {path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # TOML, CSV and unicode errors are ValueErrors
        raise FidpipeError(f"sensor {path}: not a table of beams ({cause_of(error)})") from error
    return _sensor(path, values)


def _columns(text: str) -> dict[str, Any]:
    from io import StringIO

    import pandas as pd

    rows = pd.read_csv(StringIO(text), skipinitialspace=True)
    return {str(name): rows[name].tolist() for name in rows.columns}


def _sensor(path: Path, values: dict[str, Any]) -> SensorModel:
    known = (*_ANGLES, *_UNIFORM, *_NUMBERS)
    for name in values:
        if name not in known:
            raise FidpipeError(f"sensor {path}: unknown entry {cause_of(name)}; {suggestion(name, known)}")
    if "elevation_deg" in values:
        elevation = _numbers(path, "elevation_deg", values["elevation_deg"], -90, 90)
    elif all(name in values for name in _UNIFORM):
        n, upper, lower = (_number(path, name, values[name], -90, 1000) for name in _UNIFORM)
        if n < 1 or n != round(n):
            raise FidpipeError(f"sensor {path}: channels: expected a whole number from 1, got {n:g}")
        elevation = tuple(np.linspace(upper, lower, round(n)).tolist())
    else:
        raise FidpipeError(f"sensor {path}: expected elevation_deg, or {', '.join(_UNIFORM)}")
    offset = _numbers(path, "azimuth_offset_deg", values.get("azimuth_offset_deg", [0.0] * len(elevation)), -180, 180)
    if len(offset) != len(elevation):
        raise FidpipeError(
            f"sensor {path}: expected {len(elevation)} azimuth offsets, one for each elevation; got {len(offset)}"
        )
    numbers: dict[str, Any] = {
        name: _number(path, name, values[name], *_BOUNDS.get(name, (0.0, 1e4))) for name in _NUMBERS if name in values
    }
    sensor = replace(_DEFAULTS, elevation_deg=elevation, azimuth_offset_deg=offset, **numbers)
    if sensor.min_range_m >= sensor.max_range_m:
        raise FidpipeError(f"sensor {path}: min_range_m: expected less than max_range_m, got {sensor.min_range_m:g}")
    return sensor


def _numbers(path: Path, name: str, values: Any, low: float, high: float) -> tuple[float, ...]:
    if not isinstance(values, list) or not values:
        raise FidpipeError(f"sensor {path}: {name}: expected a list of numbers, got {cause_of(repr(values))}")
    return tuple(_number(path, name, value, low, high) for value in values)


def _number(path: Path, name: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise FidpipeError(
            f"sensor {path}: {name}: expected a number from {low:g} to {high:g}, got {cause_of(repr(value))}"
        )
    return float(value)
