"""Content hashes of scan files, of which the keys of results are made. Reads bytes, starts no parser."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ...schemas.columns import SIDES
from ...schemas.errors import ScanError
from ..storage.files import file_marks, hash_file, key_of
from ..storage.urls import n_bytes_of
from .pairs import ScanPair
from .readers import files_of, format_of, stem_of
from .readers.frame_address import address_of
from .readers.scan import label_path_of

_BYTES_PER_POINT = 16
_MOST_POINTS_PER_FRAME = 250_000


@dataclass(frozen=True, slots=True)
class ScanContent:
    """Content of a scan file.

    sha256 : of the file; of a frame also of its address
    label_sha256 : of the file of its labels; "column" if the scan file may hold them; "" if it cannot have any
    approximate_points : from the size of the file; right for the rows of .bin files
    """

    sha256: str
    label_sha256: str
    approximate_points: int

    def key(self, label_names: Mapping[int, str], motion: tuple[float, ...] | None) -> str:
        """A hash of all that the scan is read from; class names count only if it may have labels."""
        return key_of(self.sha256, self.label_sha256, sorted(label_names.items()) if self.label_sha256 else [], motion)


def file_hash(path: Path) -> str:
    """SHA-256 of a file, computed once per process while its length, times and inode stay the same."""
    return _hash_once(path, file_marks(path))


def scan_content(path: Path, hash_of: Callable[[Path], str] = file_hash) -> ScanContent:
    """The content of a scan file, or of one frame of a recording.

    A frame counts as changed whenever its recording has.

    Parameters
    ----------
    hash_of : returns the hash of a file

    Raises
    ------
    ScanError
        The file is missing, empty or cannot be opened.
    """
    address, known = address_of(path), format_of(path)
    try:
        files = files_of(path)
        n_bytes = sum(map(n_bytes_of, files))
        if not n_bytes:
            raise ScanError(f"{path}: the file is empty; expected points")
        hashes = [hash_of(file) for file in files]
        label_path = label_path_of(address.file, stem_of(path))
        label_sha256 = hash_of(label_path) if label_path.exists() else ""
    except OSError as error:
        raise ScanError(f"{path}: cannot be read ({error.strerror})") from error
    if not label_sha256 and known.module and not known.columns:
        label_sha256 = "column"
    n_points = n_bytes // _BYTES_PER_POINT
    if known.holds_frames:
        sha256 = key_of(hashes, address.topic, address.frame)
        return ScanContent(sha256, label_sha256, min(n_points, _MOST_POINTS_PER_FRAME))
    return ScanContent(hashes[0], label_sha256, n_points)


def input_hashes(
    pair: ScanPair, label_names: Mapping[int, str], contents: Mapping[str, ScanContent] | None = None
) -> dict[str, str]:
    """Hashes of the inputs of a pair: each scan's by side, and `content` of all inputs.

    `content` covers scans, their labels, the names of these, and T_real_sim.

    Parameters
    ----------
    contents : by side, if the files were hashed already

    Raises
    ------
    ScanError
        A file cannot be hashed.
    """
    if contents is None:
        contents = {side: scan_content(path) for side in SIDES if (path := pair.path(side)) is not None}
    content = key_of({side: scan.key(label_names, pair.motion(side)) for side, scan in contents.items()})
    return {side: scan.sha256 for side, scan in contents.items()} | {"content": content}


@lru_cache(maxsize=256)
def _hash_once(path: Path, marks: str) -> str:
    return hash_file(path)
