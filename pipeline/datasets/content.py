"""Content hashes of scan files, of which the keys of results are made. Reads bytes, starts no parser."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ...schemas.errors import ScanError
from ..storage.files import file_marks, hash_file, key_of
from ..storage.urls import stub_size
from .pairs import ScanPair
from .readers.scan_ref import ScanRef, scan_ref

_BYTES_PER_POINT = 16
_MOST_POINTS_PER_FRAME = 250_000


@dataclass(frozen=True, slots=True)
class ScanContent:
    """Content of a scan file.

    sha256 : of the file; of a frame also of its address
    label_sha256 : of the file of its labels; "column" if the scan file may hold them; "" if it
        cannot have any
    approximate_points : from the size of the file; right for the rows of .bin files
    """

    sha256: str
    label_sha256: str
    approximate_points: int

    def key(self, label_names: Mapping[int, str], motion: tuple[float, ...] | None) -> str:
        """A hash of all that the scan is read from; class names count only if it may have labels."""
        names = sorted(label_names.items()) if self.label_sha256 else []
        return key_of(self.sha256, self.label_sha256, names, motion)


def file_hash(path: Path) -> str:
    """SHA-256 of a file, computed once per process while its length, times and inode stay the same."""
    return _hash_once(path, file_marks(path))


def scan_content(
    source: ScanRef | Path, hash_of: Callable[[Path], str] = file_hash
) -> ScanContent:
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
    scan = scan_ref(source)
    try:
        if scan.stubs:
            n_bytes = stub_size(scan.stubs[0])
            hashes = [key_of(scan.stubs[0])]
            label_sha256 = key_of(*scan.stubs[1:]) if scan.stubs[1:] else ""
        else:
            n_bytes = sum(file.stat().st_size for file in scan.files)
            hashes = [hash_of(file) for file in scan.files]
            label_sha256 = hash_of(scan.labels) if scan.labels.exists() else ""
        if not n_bytes:
            raise ScanError(f"{scan}: the file is empty; expected points")
    except OSError as error:
        raise ScanError(f"{scan}: cannot be read ({error.strerror})") from error
    if not label_sha256 and not scan.format.columns:
        label_sha256 = "column"
    n_points = n_bytes // _BYTES_PER_POINT
    if scan.format.holds_frames:
        sha256 = key_of(hashes, scan.topic, scan.frame)
        return ScanContent(sha256, label_sha256, min(n_points, _MOST_POINTS_PER_FRAME))
    return ScanContent(hashes[0], label_sha256, n_points)


def input_hashes(
    pair: ScanPair,
    label_names: Mapping[int, str],
    contents: Mapping[str, ScanContent] | None = None,
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
        contents = {side: scan_content(scan) for side, scan in pair.scans.items()}
    keys = {}
    hashes = {}
    for side, content in contents.items():
        keys[side] = content.key(label_names, pair.motion(side))
        hashes[side] = content.sha256
    return hashes | {"content": key_of(keys)}


@lru_cache(maxsize=256)
def _hash_once(path: Path, marks: str) -> str:
    return hash_file(path)
