"""Velodyne packets, VLP-16 to VLS-128: captures `.pcap`, and those of a bag; decoded by velodyne-decoder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ....schemas.errors import ScanError
from .scan import Scan, scan_from_columns
from .scan_ref import ScanRef, frame_number

_PACKET_BYTES = 1206
_LINUX_COOKED = 113


class _Revolution(NamedTuple):
    """A revolution of the sensor in a capture.

    time_ns : when its last packet came
    start, stop : bytes of the file that hold it; from the first one if `start` is None
    """

    time_ns: int
    start: int | None
    stop: int | None


def read(scan: ScanRef) -> Scan:
    """One revolution of the sensor, from a capture.

    Raises
    ------
    ScanError
        The capture is damaged, has no Velodyne packets, or no such revolution, or several.
    """
    file = scan.file
    revolutions = _revolutions(file, file.stat().st_mtime_ns)
    revolution = revolutions[
        frame_number(scan, [revolution.time_ns for revolution in revolutions])
    ]
    packets = _packets(file, revolution.start, revolution.stop)
    return scan_from_columns(file, decoded(file, [(stamp, data) for _, stamp, data in packets]))


def frames(recording: ScanRef) -> list[ScanRef]:
    """The revolutions of the sensor, in order of time.

    Raises
    ------
    ScanError
        The capture is damaged, or has no Velodyne packets.
    """
    revolutions = _revolutions(recording.file, recording.file.stat().st_mtime_ns)
    return [recording.at(revolution.time_ns) for revolution in revolutions]


def decoded(path: Path, packets: Sequence[tuple[float, bytes]]) -> dict[str, NDArray[Any]]:
    """The points of packets: x, y, z in metres, intensity, time in seconds, ring.

    Parameters
    ----------
    path : of the file, for errors and for the calibration of an HDL-64E
    packets : when each came, seconds, and its 1206 bytes
    """
    import velodyne_decoder as vd

    listed = vd.PacketVector([vd.VelodynePacket(stamp, data) for stamp, data in packets])
    _, rows = vd.ScanDecoder(_config(path, path.stat().st_mtime_ns)).decode(listed, False)
    names = ("x", "y", "z", "intensity", "time", "ring")
    return {name: rows[:, int(getattr(vd.PointField, name))] for name in names}


@lru_cache(maxsize=16)
def _revolutions(file: Path, mtime_ns: int) -> list[_Revolution]:
    """The revolutions in a capture; reads and decodes it once."""
    import velodyne_decoder as vd

    revolutions: list[_Revolution] = []
    start = None
    for stop, turn in _turns(file, vd.StreamDecoder(_config(file, mtime_ns))):
        if turn is not None and stop != start:
            time_ns = round(turn[0].host * 1e6) * 1000
            revolutions.append(_Revolution(time_ns, start, stop))
            start = stop
    if not revolutions:
        raise ScanError(
            f"{file}: no data packets of a Velodyne sensor ({_PACKET_BYTES} bytes each) found",
        )
    return revolutions


def _turns(file: Path, decoder: Any) -> Iterator[tuple[int | None, Any]]:
    """The end of each packet, and the revolution that it completes, if any; at last the unfinished one."""
    stop = None
    for stop, stamp, data in _packets(file):
        yield stop, decoder.decode(stamp, data, False)
    yield stop, decoder.finish(False)


def _packets(
    file: Path, start: int | None = None, stop: int | None = None
) -> Iterator[tuple[int, float, bytes]]:
    """Data packets between two places of a capture: where each ends, when it came in seconds, and its content."""
    import dpkt

    with file.open("rb") as stream:
        capture = dpkt.pcap.UniversalReader(stream)
        outermost = (
            dpkt.sll.SLL if capture.datalink() == _LINUX_COOKED else dpkt.ethernet.Ethernet
        )
        if start is not None:
            stream.seek(start)
        for stamp, content in capture:
            end = stream.tell()
            if stop is not None and end > stop:
                return
            try:
                inner = outermost(content)
            except dpkt.UnpackError:
                inner = b""
            while hasattr(inner, "data"):
                inner = inner.data
            if len(inner) == _PACKET_BYTES:
                yield end, float(stamp), bytes(inner)


@lru_cache(maxsize=16)
def _config(file: Path, _mtime_ns: int) -> Any:
    """Configuration of a decoder, with the model and calibration that an HDL-64E sends among its packets."""
    import dpkt
    import velodyne_decoder as vd

    config = vd.Config()
    if file.suffix.lower() != ".pcap":
        return config
    with file.open("rb") as stream:
        is_newer = isinstance(dpkt.pcap.UniversalReader(stream), dpkt.pcapng.Reader)
    if not is_newer:  # which the library does not search
        config.model, config.calibration = vd.hdl64e.detect_hdl64e(str(file))
    return config
