"""What reading a file may ask for: memory in proportion to its length, whatever its header says.

Files come from anywhere. A header that promises a billion points, a length field of four gigabytes and a chunk that
unpacks to as much are refused before memory is taken for them.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ....schemas.errors import ScanError

#: What a file may unpack to: so many bytes, and so many more for each byte that it is long.
MOST_UNPACKED_BYTES = 64 * 2**20
MOST_UNPACKED_A_BYTE = 100


def check_promise(path: Path, n_points: int, point_bytes: float) -> None:
    """Refuses a file whose header speaks of more points than its bytes can hold, before memory is taken for them.

    Parameters
    ----------
    point_bytes : that a point takes in the file, at the least

    Raises
    ------
    ScanError
        There are too many, or less than none.
    """
    n_bytes = path.stat().st_size
    if n_points < 0 or n_points * point_bytes > n_bytes:
        raise ScanError(
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
    ScanError
        It is more than `MOST_UNPACKED_BYTES` and `MOST_UNPACKED_A_BYTE` for each byte.
    """
    n_bytes = path.stat().st_size if n_bytes is None else n_bytes
    if n_unpacked > (most := most_unpacked(n_bytes)):
        raise ScanError(
            f"{path}: {n_bytes} bytes would unpack to {_short(n_unpacked)} or more, at most {most} are read; the file "
            "is wrong, or made to fill the memory"
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
        """Counts bytes that another has unpacked; raises `ScanError` where they are too many."""
        self._sizes[0] = self._sizes.get(0, 0) + n_unpacked
        check_unpacked(self._path, sum(self._sizes.values()), self._n_bytes)

    def __call__(self, content: bytes, opened: Callable[[io.BytesIO], Any]) -> bytes:
        """What a part unpacks to.

        Parameters
        ----------
        opened : the file class of a compressor, such as `bz2.BZ2File`

        Raises
        ------
        ScanError
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


def _short(number: int) -> str:
    """A number, or how many digits it has where these are more than a line takes."""
    return str(number) if abs(number) < 10**30 else "10^30 and more"
