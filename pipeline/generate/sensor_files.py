"""Sensor models by name or from a table of beams."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...schemas.data_files import read_toml
from ...schemas.errors import FidpipeError, suggestion
from ...schemas.sensor_models import SENSORS, SensorModel
from ...schemas.settings import expected_and_got
from ...stages.generate.rescan import RECORDED
from ..datasets.readers.scan import cause_of

_TABLES = (".csv", ".toml")
#: Values that a table may omit.
_DEFAULTS = replace(
    SENSORS["hdl64"],
    name="table",
    title="",
    source="",
    azimuth_step_deg=0.2,
    range_quantum_m=0.0,
)

_Elevation = Annotated[float, Field(ge=-90, le=90)]
_Amount = Annotated[float, Field(ge=0, le=1e4)]


class _Table(BaseModel):
    """Entries of a table of beams."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    elevation_deg: Annotated[list[_Elevation], Field(min_length=1)] = []
    azimuth_offset_deg: list[Annotated[float, Field(ge=-180, le=180)]] = []
    channels: Annotated[int, Field(ge=1, le=1000, strict=False)] | None = None
    upper_deg: _Elevation | None = None
    lower_deg: _Elevation | None = None
    azimuth_step_deg: Annotated[float, Field(ge=0.01, le=10)] = _DEFAULTS.azimuth_step_deg
    min_range_m: _Amount = _DEFAULTS.min_range_m
    max_range_m: _Amount = _DEFAULTS.max_range_m
    range_noise_m: _Amount = _DEFAULTS.range_noise_m
    range_quantum_m: _Amount = _DEFAULTS.range_quantum_m
    lost_share: Annotated[float, Field(ge=0, le=1)] = _DEFAULTS.lost_share
    signal_range_m: _Amount = _DEFAULTS.signal_range_m
    column_deg: _Amount = _DEFAULTS.column_deg


def read_sensor(name: str) -> SensorModel:
    """The sensor of a name in `SENSORS`, `RECORDED`, or the sensor described by a table.

    A `.csv` has a column elevation_deg and optionally azimuth_offset_deg, one row per laser. A
    `.toml` has elevation_deg (and azimuth_offset_deg) as lists, or channels, upper_deg and
    lower_deg for uniform ones; and optionally azimuth_step_deg, min_range_m, max_range_m,
    range_noise_m, range_quantum_m, lost_share.

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
        raise FidpipeError(
            f"sensor {name!r}: no such sensor; {suggestion(name, [*known, 'a table (.csv, .toml)'])}",
        )
    try:
        table = _Table.model_validate(
            read_toml(path, "sensor") if path.suffix.lower() == ".toml" else _columns(path),
        )
    except ValidationError as error:
        problem = error.errors()[0]
        entry = cause_of(problem["loc"][0])
        if problem["type"] == "extra_forbidden":
            raise FidpipeError(
                f"sensor {path}: unknown entry {entry}; {suggestion(entry, _Table.model_fields)}"
            ) from error
        raise FidpipeError(
            f"sensor {path}: {entry}: {cause_of(expected_and_got(problem))}",
        ) from error
    values = table.model_dump()
    uniform = [values.pop(name) for name in ("upper_deg", "lower_deg", "channels")]
    elevation = values.pop("elevation_deg")
    if not elevation and None in uniform:
        raise FidpipeError(
            f"sensor {path}: expected elevation_deg, or channels, upper_deg, lower_deg",
        )
    elevation = elevation or np.linspace(*uniform).tolist()
    offset = values.pop("azimuth_offset_deg") or [0.0] * len(elevation)
    if len(offset) != len(elevation):
        raise FidpipeError(
            f"sensor {path}: expected {len(elevation)} azimuth offsets, one for each elevation; got {len(offset)}",
        )
    if table.min_range_m >= table.max_range_m:
        raise FidpipeError(
            f"sensor {path}: min_range_m: expected less than max_range_m, got {table.min_range_m:g}",
        )
    return replace(
        _DEFAULTS,
        elevation_deg=tuple(elevation),
        azimuth_offset_deg=tuple(offset),
        **values,
    )


def _columns(path: Path) -> dict[str, Any]:
    import pandas as pd

    try:
        rows = pd.read_csv(path, skipinitialspace=True)
    except OSError as error:
        raise FidpipeError(f"sensor {path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # CSV and unicode errors are ValueErrors
        raise FidpipeError(f"sensor {path}: not a table of beams ({cause_of(error)})") from error
    return {str(name): rows[name].tolist() for name in rows.columns}
