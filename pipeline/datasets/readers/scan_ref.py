"""A scan by its name: `FILE`, or a frame of a recording, `FILE#FRAME`, `FILE#TOPIC` or `FILE#TOPIC@FRAME`.

FRAME is a number from 0, in the order of time, or a time in seconds with its decimal point, as it
is listed. A time is found by the recording's own index; a number requires the times of all frames,
read once per process.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

from ....schemas.errors import ScanError
from ...storage.urls import STUB, stub_text
from .formats import Format, known_formats

_NUMBER = re.compile(r"\d+(\.\d+)?")
_NANOSECONDS = 10**9
_UNKNOWN = Format("")


@dataclass(frozen=True, slots=True)
class ScanRef:
    """A scan: a file, or one frame of it. Its text names it to users and in manifests.

    file : the file; the folder of a bag; the stub of a remote scan
    suffix : the known suffix in lower case; "" if the format is not known
    topic : of a bag; None for the only one with point clouds
    frame : number or time in seconds, as written; None for the only one
    stubs : of a remote scan, the text of its stub, and of that of its labels if there are any
    """

    file: Path
    suffix: str = ""
    format: Format = _UNKNOWN
    topic: str | None = None
    frame: str | None = None
    stubs: tuple[str, ...] = ()

    def __str__(self) -> str:
        address = "@".join(filter(None, (self.topic, self.frame)))
        return f"{self.file}#{address}" if address else str(self.file)

    @property
    def stem(self) -> str:
        """The file name without its known suffix, by which scans are paired; of a frame with topic and frame."""
        name = self.file.stem if self.stubs else self.file.name
        if not self.suffix.startswith("/"):
            name = name[: len(name) - len(self.suffix)]
        topics = (self.topic or "").split("/")
        return "-".join(filter(None, [name, *topics, self.frame]))

    @property
    def labels(self) -> Path:
        """Path of the labels next to the file; they may not exist."""
        return self.file.with_name(f"{self.stem}.label{STUB if self.stubs else ''}")

    @property
    def files(self) -> list[Path]:
        """The files that the scan is read from."""
        if not self.file.is_dir():
            return [self.file]
        return sorted(path for path in self.file.iterdir() if path.is_file())

    @property
    def exists(self) -> bool:
        """True if the file, or the folder of a bag, exists."""
        return self.file.is_file() or self.suffix.startswith("/")

    @property
    def time_ns(self) -> int | None:
        """Time of the frame; None if it is named by a number, or not at all."""
        if self.frame is None or "." not in self.frame:
            return None
        return int(Decimal(self.frame) * _NANOSECONDS)

    def absolute(self) -> ScanRef:
        """The same scan with an absolute path."""
        return replace(self, file=self.file.absolute())

    def at(self, time_ns: int) -> ScanRef:
        """The frame of this time of the same topic."""
        return replace(self, frame=_seconds(time_ns))


def scan_ref(source: ScanRef | Path | str) -> ScanRef:
    """The scan of a name: a file, which may not exist, or a frame of one.

    Examples
    --------
    >>> scan = scan_ref("drive.mcap#/lidar/points@12")
    >>> scan.file.name, scan.topic, scan.frame, scan.stem
    ('drive.mcap', '/lidar/points', '12', 'drive-lidar-points-12')
    >>> scan_ref("sweeps.pcap#1713492677.528578000").time_ns
    1713492677528578000
    """
    if isinstance(source, ScanRef):
        return source
    path = Path(source)
    file, mark, fragment = str(path).rpartition("#")
    if not mark or path.exists():
        return _file_ref(path)
    topic, at, frame = fragment.rpartition("@")
    if not at and not _NUMBER.fullmatch(frame):
        topic, frame = fragment, ""
    if frame and not _NUMBER.fullmatch(frame):
        raise ScanError(
            f"{path}: expected a frame number from 0 or a time in seconds, got {frame!r}",
        )
    return replace(_file_ref(Path(file)), topic=topic or None, frame=frame or None)


def _file_ref(file: Path) -> ScanRef:
    known = known_formats()
    stub = stub_text(file)
    name = file.stem if stub else file.name
    suffix = _suffix_of(file, name.lower(), known)
    scan = ScanRef(file, suffix, known.get(suffix, _UNKNOWN))
    if not stub:
        return scan
    scan = replace(scan, stubs=(stub,))
    labels = stub_text(scan.labels)
    return replace(scan, stubs=(stub, labels)) if labels else scan


def _suffix_of(file: Path, name: str, known: dict[str, Format]) -> str:
    for i, character in enumerate(name):
        if character == "." and name[i:] in known:
            return name[i:]
    for suffix in known:
        if suffix.startswith("/") and (file / suffix[1:]).is_file():
            return suffix
    return ""


def frame_number(scan: ScanRef, times_ns: Sequence[int]) -> int:
    """Number of a frame of a recording, from 0.

    Parameters
    ----------
    times_ns : of all frames, in order

    Raises
    ------
    ScanError
        No frame has this number or time, or there are several and no frame is given.
    """
    numbers = list(range(len(times_ns)))
    if scan.time_ns is not None:
        numbers = [number for number in numbers if times_ns[number] == scan.time_ns]
    elif scan.frame is not None:
        numbers = numbers[int(scan.frame) :][:1]
    if len(numbers) == 1:
        return numbers[0]
    times = " to ".join(map(_seconds, (*times_ns[:1], *times_ns[-1:])))
    raise ScanError(
        f"{scan}: expected one frame, got {len(numbers)} of {len(times_ns)} ({times} s); name one in "
        f"a pairs.csv, such as {replace(scan, frame='0')}"
    )


def _seconds(time_ns: int) -> str:
    return f"{time_ns // _NANOSECONDS}.{time_ns % _NANOSECONDS:09}"
