"""Addresses of frames of a recording: `FILE#FRAME`, `FILE#TOPIC` or `FILE#TOPIC@FRAME`.

FRAME is a number from 0, in the order of time, or a time in seconds with its decimal point, as it is listed. A time is
found by the recording's own index; a number wants the times of all frames, once in a process.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ....schemas.errors import ScanError

_NUMBER = re.compile(r"\d+(\.\d+)?")
_NANOSECONDS = 10**9


class Address(NamedTuple):
    """A scan: a file, or one frame of it.

    topic : of a bag, or None: the only one with point clouds
    frame : number or time in seconds, as written; or None: the only one
    """

    file: Path
    topic: str | None = None
    frame: str | None = None

    @property
    def time_ns(self) -> int | None:
        """The time in the address; None if it has a number, or nothing."""
        if self.frame is None or "." not in self.frame:
            return None
        seconds, _, rest = self.frame.partition(".")
        return int(seconds) * _NANOSECONDS + int(rest.ljust(9, "0")[:9])

    def at(self, time_ns: int) -> Path:
        """The path that names the frame of this time."""
        topic = f"{self.topic}@" if self.topic else ""
        return Path(f"{self.file}#{topic}{_seconds(time_ns)}")


def address_of(path: Path) -> Address:
    """Target of a path: a file, or a frame of one.

    Examples
    --------
    >>> address_of(Path("drive.mcap#/lidar/points@12"))
    Address(file=PosixPath('drive.mcap'), topic='/lidar/points', frame='12')
    >>> address_of(Path("sweeps.pcap#1713492677.528578000")).time_ns
    1713492677528578000
    """
    file, mark, fragment = str(path).rpartition("#")
    if not mark or path.exists():
        return Address(path)
    topic, at, frame = fragment.rpartition("@")
    if not at:
        topic, frame = ("", fragment) if _NUMBER.fullmatch(fragment) else (fragment, "")
    if frame and not _NUMBER.fullmatch(frame):
        raise ScanError(f"{path}: expected a frame number from 0 or a time in seconds, got {frame!r}")
    return Address(Path(file), topic or None, frame or None)


def frame_number(address: Address, times_ns: Sequence[int]) -> int:
    """Number of the addressed frame of a recording, from 0.

    Parameters
    ----------
    times_ns : of all frames, in order

    Raises
    ------
    ScanError
        No frame has this number or time, or there are several and no frame is given.
    """
    name = f"{address.file.name}#{address.topic}@" if address.topic else f"{address.file.name}#"
    if not times_ns:
        raise ScanError(f"{address.file}: no frames found; expected at least one")
    if address.frame is None:
        if len(times_ns) > 1:
            raise ScanError(
                f"{address.file}: {len(times_ns)} frames found; name one of {name}0 to {name}{len(times_ns) - 1}, "
                "in a pairs.csv for instance"
            )
        return 0
    if (time_ns := address.time_ns) is not None:
        if times_ns.count(time_ns) == 1:
            return times_ns.index(time_ns)
        nearest = min(range(len(times_ns)), key=lambda i: abs(times_ns[i] - time_ns))
        raise ScanError(
            f"{address.file}: expected one frame at {address.frame} s, got {times_ns.count(time_ns)}; the nearest is "
            f"number {nearest}, {name}{_seconds(times_ns[nearest])}"
        )
    if int(address.frame) >= len(times_ns):
        raise ScanError(f"{address.file}: no frame {address.frame}; the last is {len(times_ns) - 1}")
    return int(address.frame)


def _seconds(time_ns: int) -> str:
    return f"{time_ns // _NANOSECONDS}.{time_ns % _NANOSECONDS:09}"
