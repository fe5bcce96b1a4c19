"""Comma-separated `.csv` with a header line; read by pandas."""

from __future__ import annotations

import csv
from contextlib import suppress
from pathlib import Path

from ....schemas.errors import ScanError
from .scan import Scan, cause_of, check_names, scan_from_columns

_LONGEST_HEADER_BYTES, _MOST_COLUMNS = 2**20, 1000  # a column costs pandas a thousand bytes, regardless of its content


def read(path: Path, columns: tuple[str, ...] = ()) -> Scan:
    """The scan in a `.csv` file; an empty cell becomes NaN.

    Parameters
    ----------
    columns : names of the columns of a file that has as many, instead of those in its header

    Raises
    ------
    ScanError
        The file is not a table, has no header, a column is missing, or a coordinate is not a number.
    """
    import pandas as pd

    names, values = _first_lines(path)
    if len(names) > _MOST_COLUMNS:
        raise ScanError(f"{path}: {len(names)} columns found, at most {_MOST_COLUMNS} are read")
    remedy = f"name its {len(names)} columns in input.columns, input.real_columns or input.sim_columns"
    has_header = not all(map(_is_number, names))
    is_named = bool(columns) and len(columns) == len(names)
    if not (has_header or is_named):
        found = cause_of(",".join(names))
        raise ScanError(f"{path}: expected a header such as x,y,z,intensity, got {found}; write one, or {remedy}")
    if has_header and len(names) == 1:
        raise ScanError(
            f"{path}: expected names of columns separated by commas, got {cause_of(names[0])}; for semicolons and "
            "decimal commas, convert it: pandas.read_csv(file, sep=';', decimal=',').to_csv(file, index=False)"
        )
    if any(values[len(names) :]):
        raise ScanError(
            f"{path}: expected {len(names)} values in a row, got {len(values)}: {cause_of(','.join(values))}; "
            "are these decimal commas? write decimal points"
        )
    names = list(columns) if is_named else names
    check_names(path, names, f"; rename them, or {remedy}")
    header = 0 if has_header else None
    frame = pd.read_csv(path, skipinitialspace=True, low_memory=False, header=header, index_col=False)
    return scan_from_columns(path, {name: frame.iloc[:, i].to_numpy() for i, name in enumerate(names)})


def _first_lines(path: Path) -> tuple[list[str], list[str]]:
    """Cells of the first two lines; openpylivox begins its header with //."""
    with path.open("rb") as file:
        lines = [file.readline(_LONGEST_HEADER_BYTES).decode("utf-8-sig", errors="replace") for _ in range(2)]
    names, values = ([cell.strip() for cell in next(csv.reader([line]), [])] for line in lines)
    names[:1] = [name.lstrip("/# ") for name in names[:1]]
    return names, values


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        float(text)
        return True
    return False
