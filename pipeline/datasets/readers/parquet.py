"""Apache `.parquet` with columns x, y, z and perhaps intensity and label; read by pyarrow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ....schemas.errors import ScanError
from .bounds import BoundedFile, check_unpacked
from .scan import KNOWN_COLUMNS, Scan, check_names, refused_unless, scan_from_columns

_VALUE_BYTES = 8
_MOST_METADATA = 2**20  # names and lists in the footer
_DICTIONARY_PAGE = 2
_LONGEST_HEAD_BYTES = 2**16
_DEEPEST = 8
#: Types of Thrift's compact protocol: numbers of variable length; true, false, byte and double by their bytes.
_VARYING, _BINARY, _LISTS, _STRUCT = (4, 5, 6), 8, (9, 10), 12
_FIXED_BYTES, _BOOLEANS = {1: 0, 2: 0, 3: 1, 7: 8}, (1, 2)


def read(path: Path) -> Scan:
    """The scan in a Parquet file; null becomes NaN. Other columns than those of a scan are not read.

    Raises
    ------
    ScanError
        The file is not whole, a column is missing, a coordinate is no number, or it would unpack to far more than a
        scan.
    """
    import pyarrow.parquet as pq

    limits = {"thrift_string_size_limit": _MOST_METADATA, "thrift_container_size_limit": _MOST_METADATA}
    with refused_unless(path, "a whole Parquet file"), BoundedFile(path) as stream:
        file = pq.ParquetFile(stream, arrow_extensions_enabled=False, pre_buffer=False, **limits)
        names = [field.name for field in file.schema_arrow]
        check_names(path, names)
        chosen = [name for name in names if name.lower() in KNOWN_COLUMNS]
        _check_pages(path, stream, file.metadata, set(chosen))
        stream.seek(0)
        table = file.read(chosen, use_threads=False)
        columns = {name: table.column(name).to_numpy() for name in chosen}
    return scan_from_columns(path, columns)


def _check_pages(path: Path, stream: BoundedFile, metadata: Any, chosen: set[str]) -> None:
    """Refuses columns that would unpack to far more than a scan: by their rows, and by what their pages say.

    A run of equal values is a few bytes however long it is, and so is a page of a compressor. The footer tells of the
    rows, and each page of its own length, which the reader takes memory for.
    """
    n_unpacked = 0
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for column in map(group.column, range(group.num_columns)):
            if column.path_in_schema.partition(".")[0] not in chosen:
                continue
            start = column.dictionary_page_offset if column.has_dictionary_page else column.data_page_offset
            value_bytes = _VALUE_BYTES
            for kind, n_page in _pages(path, stream, start, start + column.total_compressed_size):
                n_unpacked += n_page
                if kind == _DICTIONARY_PAGE and column.physical_type == "BYTE_ARRAY":
                    value_bytes = max(value_bytes, n_page)  # any row may be its longest word
            n_unpacked += max(column.num_values, group.num_rows) * value_bytes
            check_unpacked(path, n_unpacked)


def _pages(path: Path, stream: BoundedFile, start: int, stop: int) -> Iterator[tuple[int, int]]:
    """Kind of each page of a column, and its bytes once unpacked, as its head says (parquet.thrift, PageHeader)."""
    n_bytes = path.stat().st_size
    while start < min(stop, n_bytes):
        stream.seek(start)
        head = _ThriftStruct(stream.read(_LONGEST_HEAD_BYTES))
        kind, unpacked, packed = (head.numbers.get(field, -1) for field in (1, 2, 3))
        if unpacked < 0 or packed < 0:
            raise ScanError(f"{path}: a page of {packed} bytes that unpack to {unpacked} found; the file is wrong")
        yield kind, unpacked
        start += head.n_bytes + packed


class _ThriftStruct:
    """A struct in Thrift's compact protocol: whole numbers of its own by field, and how long it is.

    https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
    """

    def __init__(self, content: bytes) -> None:
        self._content, self.n_bytes = content, 0
        self.numbers: dict[int, int] = {}
        self._struct(self.numbers, _DEEPEST)

    def _struct(self, numbers: dict[int, int], depth: int) -> None:
        if not depth:
            raise ValueError("structs in structs without end")
        field = 0
        while head := self._byte():
            field = field + (head >> 4) if head >> 4 else self._number()
            value = self._value(head & 15, depth)
            if value is not None:
                numbers[field] = value

    def _value(self, kind: int, depth: int, *, in_list: bool = False) -> int | None:
        if kind in _VARYING:
            return self._number()
        if kind in _FIXED_BYTES:
            self.n_bytes += 1 if in_list and kind in _BOOLEANS else _FIXED_BYTES[kind]
        elif kind == _BINARY:
            length = self._varint()
            self.n_bytes += length
        elif kind in _LISTS:
            head = self._byte()
            for _ in range(self._varint() if head >> 4 == 15 else head >> 4):
                self._value(head & 15, depth - 1, in_list=True)
        elif kind == _STRUCT:
            self._struct({}, depth - 1)
        else:
            raise ValueError(f"type {kind} in the head of a page")
        return None

    def _byte(self) -> int:
        self.n_bytes += 1
        if self.n_bytes > len(self._content):
            raise ValueError("the head of a page has no end")
        return self._content[self.n_bytes - 1]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 0x80:
            value, shift = value | (byte & 0x7F) << shift, shift + 7
        return value | byte << shift

    def _number(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)
