"""Tables of data next to this file, and TOML files of users."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

from .errors import SettingsError


def read_data(name: str) -> dict[str, Any]:
    """Values of `NAME.toml`."""
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text("utf-8"))


def read_rows(name: str) -> list[dict[str, str]]:
    """Rows of `NAME.csv` by column."""
    with Path(__file__).with_name(f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def parse_toml(text: str) -> dict[str, Any]:
    """Values of a TOML text; `tomllib.TOMLDecodeError`, a ValueError, also for lists nested too deeply."""
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise tomllib.TOMLDecodeError("nested too deeply") from error


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Values of a TOML file of some kind; `SettingsError` if it cannot be read or is not valid."""
    try:
        return parse_toml(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{kind} {path}: not valid TOML ({error})") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SettingsError(f"{kind} {path}: cannot be read ({reason})") from error
