"""Comma-separated `.csv` with a header line; read by pandas."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import BinaryIO

from ....schemas.errors import ScanError
from .scan import Scan, cause_of, check_names, is_number, scan_from_columns

_LONGEST_HEADER_BYTES = 2**20
_MOST_COLUMNS = 1000  # a column costs pandas a thousand bytes, regardless of its content


def read(path: Path, columns: tuple[str, ...] = ()) -> Scan:
    """The scan in a `.csv` file; an empty cell becomes NaN.

    Parameters
    ----------
    columns : names of the columns of a file that has as many, instead of those in its header

    Raises
    ------
    ScanError
        The file is not a table, has no header, a column is missing, or a coordinate is not a
        number.
    """
    import pandas as pd

    with path.open("rb") as file:
        names = _cells(file)
        values = _cells(file)
    n_columns = len(names)
    if n_columns > _MOST_COLUMNS:
        raise ScanError(f"{path}: {n_columns} columns found, at most {_MOST_COLUMNS} are read")
    remedy = f"name its {n_columns} columns in input.columns, input.real_columns or input.sim_columns"
    has_header = not all(is_number(name) for name in names)
    if columns and len(columns) == n_columns:
        names = list(columns)
    elif not has_header:
        raise ScanError(
            f"{path}: expected a header such as x,y,z,intensity, got {cause_of(','.join(names))}; "
            f"write one, or {remedy}",
        )
    if has_header and n_columns == 1:
        raise ScanError(
            f"{path}: expected names of columns separated by commas, got {cause_of(names[0])}; "
            "for semicolons and decimal commas, convert it: pandas.read_csv(file, sep=';', "
            "decimal=',').to_csv(file, index=False)"
        )
    if any(values[n_columns:]):
        raise ScanError(
            f"{path}: expected {n_columns} values in a row, got {len(values)}: "
            f"{cause_of(','.join(values))}; are these decimal commas? write decimal points"
        )
    check_names(path, names, f"; rename them, or {remedy}")
    frame = pd.read_csv(
        path,
        names=range(len(names)),  # columns that are not used may share a name
        header=0 if has_header else None,
        skipinitialspace=True,
        low_memory=False,
        index_col=False,
    )
    return scan_from_columns(path, {name: frame[i].to_numpy() for i, name in enumerate(names)})


def _cells(file: BinaryIO) -> list[str]:
    """Cells of the next line; openpylivox begins its header with //."""
    line = file.readline(_LONGEST_HEADER_BYTES).decode("utf-8-sig", errors="replace")
    return [cell.strip() for cell in next(csv.reader([line.lstrip("/# ")]), [])]
