"""What reading a file may ask for: memory in proportion to its length, whatever its header says.

Files come from anywhere. A header that promises a billion points, a length field of four gigabytes and a chunk that
unpacks to as much are refused before memory is taken for them.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from ...schemas.errors import OversizeError

Value = TypeVar("Value")

#: What a file may unpack to: so many bytes, and so many more for each byte that it is long.
MOST_UNPACKED_BYTES = 64 * 2**20
MOST_UNPACKED_A_BYTE = 100

_VALUE_BYTES = 8
_DICTIONARY_PAGE, _BYTE_ARRAY = 2, 6  # parquet.thrift, PageType and Type
_LONGEST_HEAD_BYTES = 2**16
_DEEPEST, _LONGEST_SHIFT = 20, 63
#: Types of Thrift's compact protocol: numbers of variable length; true, false, byte and double by their bytes.
_VARYING, _BINARY, _LISTS, _STRUCT = (4, 5, 6), 8, (9, 10), 12
_FIXED_BYTES, _BOOLEANS = {1: 0, 2: 0, 3: 1, 7: 8}, (1, 2)


def check_promise(path: Path, n_points: int, point_bytes: float) -> None:
    """Refuses a file whose header speaks of more points than its bytes can hold, before memory is taken for them.

    Parameters
    ----------
    point_bytes : that a point takes in the file, at the least

    Raises
    ------
    OversizeError
        There are too many, or less than none.
    """
    n_bytes = path.stat().st_size
    if n_points < 0 or n_points * point_bytes > n_bytes:
        raise OversizeError(
            f"{path}: the header says {_short(n_points)} points, in {n_bytes} bytes; the file is truncated or wrong"
        )


def check_unpacked(path: Path, n_unpacked: int, n_bytes: int | None = None) -> None:
    """Refuses what would unpack to far more than any scan does.

    Parameters
    ----------
    n_unpacked : bytes, as the header says or as they were counted
    n_bytes : that are unpacked; by default the file

    Raises
    ------
    OversizeError
        It is more than `MOST_UNPACKED_BYTES` and `MOST_UNPACKED_A_BYTE` for each byte.
    """
    n_bytes = path.stat().st_size if n_bytes is None else n_bytes
    if n_unpacked > (most := most_unpacked(n_bytes)):
        raise OversizeError(
            f"{path}: {n_bytes} bytes would unpack to {_short(n_unpacked)} or more, at most {most} are read; the file "
            "is wrong, or made to fill the memory; if it is right, write it without compression and dictionaries"
        )


def most_unpacked(n_bytes: int) -> int:
    """Bytes that so many may unpack to."""
    return MOST_UNPACKED_BYTES + MOST_UNPACKED_A_BYTE * n_bytes


class Unpacker:
    """Unpacks the parts of one file, all of them together to no more than `check_unpacked` allows.

    A part that comes again counts once: only one at a time is in memory then.

    Parameters
    ----------
    n_bytes : of the file, or of all files of a folder
    """

    def __init__(self, path: Path, n_bytes: int) -> None:
        self._path, self._n_bytes = path, n_bytes
        self._sizes: dict[int, int] = {}

    def count(self, n_unpacked: int) -> None:
        """Counts bytes that another has unpacked; raises `OversizeError` where they are too many."""
        self._sizes[0] = self._sizes.get(0, 0) + n_unpacked
        check_unpacked(self._path, sum(self._sizes.values()), self._n_bytes)

    def __call__(self, content: bytes, opened: Callable[[io.BytesIO], Any]) -> bytes:
        """What a part unpacks to.

        Parameters
        ----------
        opened : the file class of a compressor, such as `bz2.BZ2File`

        Raises
        ------
        OversizeError
            It is too much.
        """
        part = hash(content)
        n_others = sum(self._sizes.values()) - self._sizes.get(part, 0)
        with opened(io.BytesIO(content)) as stream:
            unpacked: bytes = stream.read(max(most_unpacked(self._n_bytes) - n_others, 0) + 1)
        self._sizes[part] = len(unpacked)
        check_unpacked(self._path, n_others + len(unpacked), self._n_bytes)
        return unpacked


class BoundedFile(io.BufferedReader):
    """A file to be read of which nobody can ask for more bytes at once than it has."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._n_bytes = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """As of any file; a length beyond the file's is taken for the file's."""
        return super().read(size if size is None or size < self._n_bytes else self._n_bytes)


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path whose binary files are bounded, for libraries that open their files themselves."""

    def open(self, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        """The file, as `Path.open` gives it; a `BoundedFile` where it is binary."""
        return BoundedFile(Path(self)) if mode == "rb" else super().open(mode, *arguments, **options)


def check_pages(path: Path, stream: BinaryIO, is_read: Callable[[str], bool] = lambda name: True) -> None:
    """Refuses columns of a Parquet file that would unpack to far more than any scan: by their rows and by their pages.

    A run of equal values is a few bytes however long it is, and so is a page of a compressor. The footer tells of the
    rows, and each page of its own length, which pyarrow takes memory for. Both are read here: pyarrow's own view of a
    damaged footer ends the process. A text that is stored once counts as often as it occurs.

    Parameters
    ----------
    stream : the file
    is_read : tells of a column whether it is read, by its name

    Raises
    ------
    OversizeError
        They are too large together.
    ValueError
        It is no whole Parquet file.
    """
    n_bytes = stream.seek(0, 2)
    stream.seek(max(n_bytes - 8, 0))
    n_footer, mark = int.from_bytes(stream.read(4), "little"), stream.read(4)
    if mark != b"PAR1" or n_footer + 8 > n_bytes:
        raise ValueError("no footer of a Parquet file")
    stream.seek(n_bytes - 8 - n_footer)
    n_unpacked, most_text, texts = 0, 0, set()
    for group in _fields(_Thrift(stream.read(n_footer)).struct(), 4, list):  # parquet.thrift, FileMetaData.row_groups
        for chunk in _fields(group, 1, list):
            column = _fields(chunk, 3, dict)
            names = _fields(column, 3, list)
            if not names or not isinstance(names[0], bytes):
                raise ValueError("a column of a Parquet file without a name")
            if not is_read(names[0].decode()):
                continue
            n_values, n_packed, first_page = (_fields(column, field, int) for field in (5, 7, 9))
            start = min(first_page, column.get(11) or first_page)
            n_rows = max(n_values, _fields(group, 3, int))
            for kind, n_page in _pages(stream, start, min(start + n_packed, n_bytes)) if n_values else ():
                n_unpacked += n_page
                if kind == _DICTIONARY_PAGE and column.get(1) == _BYTE_ARRAY:
                    texts.add(names[0].decode())
                    most_text += n_rows * n_page  # if each row had all texts of the dictionary
            n_unpacked += n_rows * _VALUE_BYTES
            check_unpacked(path, n_unpacked, n_bytes)
    if n_unpacked + most_text > most_unpacked(n_bytes):
        check_unpacked(path, n_unpacked + _text_bytes(stream, sorted(texts)), n_bytes)


def _text_bytes(stream: BinaryIO, names: list[str]) -> int:
    """Length of all texts of these columns of a Parquet file, counted without repeating them in memory."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    stream.seek(0)
    file = pq.ParquetFile(stream, read_dictionary=names, pre_buffer=False)
    parts = [part for column in file.read(names, use_threads=False).itercolumns() for part in column.chunks]
    return sum(pc.sum(pc.binary_length(part.dictionary).take(part.indices)).as_py() or 0 for part in parts)


def _pages(stream: BinaryIO, start: int, stop: int) -> Iterator[tuple[int, int]]:
    """Kind of each page of a column, and its bytes once unpacked, as its head says."""
    while 0 <= start < stop:
        stream.seek(start)
        head = _Thrift(stream.read(_LONGEST_HEAD_BYTES))
        fields = head.struct()
        kind, n_unpacked, n_packed = (_fields(fields, field, int) for field in (1, 2, 3))
        if n_unpacked < 0 or n_packed < 0:
            raise ValueError(f"a page of {n_packed} bytes that unpack to {n_unpacked}")
        yield kind, n_unpacked
        start += head.place + n_packed


def _fields(struct: Any, field: int, kind: type[Value]) -> Value:
    """A field of a Thrift struct, of this type; `ValueError` where there is none."""
    value = struct.get(field) if isinstance(struct, dict) else None
    if not isinstance(value, kind):
        raise ValueError(f"no field {field} of a Parquet file")
    return value


class _Thrift:
    """Reads values in Thrift's compact protocol; a struct is a dictionary by the numbers of its fields.

    https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
    """

    def __init__(self, content: bytes) -> None:
        self._content, self.place = content, 0

    def struct(self, depth: int = _DEEPEST) -> dict[int, Any]:
        """The struct at the place that is reached."""
        fields: dict[int, Any] = {}
        field = 0
        while head := self._byte():
            field = field + (head >> 4) if head >> 4 else self._number()
            fields[field] = self._value(head & 15, depth, in_list=False)
        return fields

    def _value(self, kind: int, depth: int, *, in_list: bool) -> Any:
        if not depth:
            raise ValueError("values in values without end")
        if kind in _VARYING:
            return self._number()
        if kind in _FIXED_BYTES:
            return self._bytes(1 if in_list and kind in _BOOLEANS else _FIXED_BYTES[kind])
        if kind == _BINARY:
            return self._bytes(self._varint())
        if kind in _LISTS:
            head = self._byte()
            n_values = self._varint() if head >> 4 == 15 else head >> 4
            return [self._value(head & 15, depth - 1, in_list=True) for _ in range(n_values)]
        if kind == _STRUCT:
            return self.struct(depth - 1)
        raise ValueError(f"a value of type {kind} in a Parquet file")

    def _byte(self) -> int:
        self.place += 1
        if self.place > len(self._content):
            raise ValueError("a value of a Parquet file has no end")
        return self._content[self.place - 1]

    def _bytes(self, n_bytes: int) -> bytes:
        start, self.place = self.place, self.place + n_bytes
        if self.place > len(self._content):
            raise ValueError("a value of a Parquet file has no end")
        return self._content[start : self.place]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 0x80:
            value, shift = value | (byte & 0x7F) << shift, shift + 7
            if shift > _LONGEST_SHIFT:
                raise ValueError("a number of a Parquet file has no end")
        return value | byte << shift

    def _number(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)


def _short(number: int) -> str:
    """A number, or how many digits it has where these are more than a line takes."""
    return str(number) if abs(number) < 10**30 else "10^30 and more"
