"""ROS bags: ROS 1 `.bag`; ROS 2 folders with a `metadata.yaml`, `.db3` and `.mcap`; read by rosbags.

A frame is a message of sensor_msgs/PointCloud2, foxglove.PointCloud, or velodyne_msgs/VelodyneScan. Its time is that of
its recording.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.errors import ScanError
from . import foxglove
from .frame_address import Address, frame_number
from .scan import Scan, scan_from_columns

_CLOUD, _PACKETS, _PACKET = (
    "sensor_msgs/msg/PointCloud2",
    "velodyne_msgs/msg/VelodyneScan",
    "velodyne_msgs/msg/VelodynePacket",
)
_DEFINITIONS = {
    _PACKETS: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    _PACKET: "time stamp\nuint8[1206] data\n",
}
_ROS2_PACKET = "builtin_interfaces/Time stamp\nuint8[1206] data\n"
_NUMBERS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # PointField.INT8 is 1, and so on


def read(address: Address) -> Scan:
    """One frame of a bag.

    Raises
    ------
    ScanError
        The bag is damaged, or has no such topic or frame, or several.
    """
    with _opened(address.file) as bag:
        topic = _topic(bag, address)
        connections = [connection for connection in bag.connections if connection.topic == topic]
        named = Address(address.file, topic, address.frame)
        start = stop = None
        if address.frame is not None and (start := address.time_ns) is not None:
            stop = start + 1
        messages = list(bag.messages(connections, start, stop)) if stop else []
        if len(messages) != 1:
            times_ns = _times_ns(address.file, _marks(address.file), topic)
            number = frame_number(named, times_ns)
            time_ns = times_ns[number]
            messages = list(bag.messages(connections, time_ns, time_ns + 1))
            messages = messages[number - times_ns.index(time_ns) :]
        connection, _, content = messages[0]
        if connection.msgtype == foxglove.CLOUD:
            columns, stamp_s = foxglove.cloud_of(address.file, connection, content)
            return replace(scan_from_columns(address.file, columns), stamp_s=stamp_s)
        types = _types(is_ros1 := _is_ros1(address.file))
        deserialize = types.deserialize_ros1 if is_ros1 else types.deserialize_cdr
        message = deserialize(content, connection.msgtype)
        if connection.msgtype == _CLOUD:
            columns = _cloud_columns(address.file, message)
        else:
            from .velodyne import decoded

            packets = [(p.stamp.sec + p.stamp.nanosec * 1e-9, p.data.tobytes()) for p in message.packets]
            columns = decoded(address.file, packets)
    stamp = message.header.stamp
    return replace(scan_from_columns(address.file, columns), stamp_s=stamp.sec + stamp.nanosec * 1e-9)


def frames(address: Address) -> list[Path]:
    """Addresses of the frames of the topic, in order of time.

    Raises
    ------
    ScanError
        The bag is damaged, or has no such topic, or several.
    """
    with _opened(address.file) as bag:
        topic = _topic(bag, address)
    named = Address(address.file, topic)
    return [named.at(time_ns) for time_ns in _times_ns(address.file, _marks(address.file), topic)]


def topics(file: Path) -> list[str]:
    """The topics of a bag, with any type of message.

    Raises
    ------
    ScanError
        The bag is damaged.
    """
    with _opened(file) as bag:
        return [connection.topic for connection in bag.connections]


def _opened(file: Path) -> Any:
    """The bag's reader, a context."""
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    reader = Ros1Reader if _is_ros1(file) else Ros2Reader
    files = [str(each.absolute()) for each in (file.iterdir() if file.is_dir() else [file])]
    if wrong := [name for name in files if name.endswith(".db3") and any(sign in name for sign in "%?#")]:
        raise ScanError(f"{wrong[0]}: expected a path without %, ? and #, which SQLite reads as parts of an address")
    return foxglove.opened(file) if _is_other_mcap(file) else reader(file)


def _is_ros1(file: Path) -> bool:
    return file.suffix.lower() == ".bag" and not file.is_dir()


def _is_other_mcap(file: Path) -> bool:
    """True for an MCAP file whose header, its first record, has another profile than ROS 2."""
    if file.suffix.lower() != ".mcap" or file.is_dir():
        return False
    with file.open("rb") as stream:
        head = stream.read(25)
    return head.startswith(b"\x89MCAP") and not head.endswith(b"\4\0\0\0ros2")


def _topic(bag: Any, address: Address) -> str:
    """The topic that is named, or the only one of point clouds, or else of packets."""
    n_frames: dict[str, dict[str, int]] = {_CLOUD: {}, foxglove.CLOUD: {}, _PACKETS: {}}
    for connection in bag.connections:
        if connection.msgtype in n_frames:
            of_type = n_frames[connection.msgtype]
            of_type[connection.topic] = of_type.get(connection.topic, 0) + connection.msgcount
    clouds = n_frames[_CLOUD] | n_frames[foxglove.CLOUD]
    known = clouds | n_frames[_PACKETS]
    listed = ", ".join(f"{topic} ({n} frames)" for topic, n in sorted(known.items()))
    if not known:
        others = ", ".join(sorted({f"{one.topic} ({one.msgtype})" for one in bag.connections})) or "no topics"
        raise ScanError(f"{address.file}: expected a topic of {', '.join(n_frames)}, got {others}")
    if address.topic is not None:
        if address.topic not in known:
            raise ScanError(f"{address.file}: no point clouds on topic {address.topic}; they are on {listed}")
        return address.topic
    candidates = clouds or n_frames[_PACKETS]
    if len(candidates) > 1:
        example = f"{address.file.name}#{min(candidates)}@{address.frame or 0}"
        raise ScanError(f"{address.file}: point clouds on {listed}; name one topic, such as {example}")
    return next(iter(candidates))


def _marks(file: Path) -> tuple[tuple[int, int], ...]:
    """Lengths and times of the bag's files: while they stay, so do its frames."""
    files = sorted(file.iterdir()) if file.is_dir() else [file]
    return tuple((status.st_size, status.st_mtime_ns) for status in map(Path.stat, files))


@lru_cache(maxsize=16)
def _times_ns(file: Path, marks: tuple[tuple[int, int], ...], topic: str) -> list[int]:
    """When each frame of a topic was recorded, in order; reads the bag once."""
    with _opened(file) as bag:
        connections = [connection for connection in bag.connections if connection.topic == topic]
        times_ns = [time_ns for _, time_ns, _ in bag.messages(connections)]
        if not all(isinstance(time_ns, int) and time_ns >= 0 for time_ns in times_ns):
            raise ScanError(f"{file}: expected a time in nanoseconds for each frame; a frame has none")
        return times_ns


@cache
def _types(is_ros1: bool) -> Any:
    """The message types that are read; the same in all distributions."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    for name, definition in _DEFINITIONS.items():
        text = _ROS2_PACKET if name == _PACKET and not is_ros1 else definition
        types.register(get_types_from_msg(text, name))
    return types


def _cloud_columns(file: Path, cloud: Any) -> dict[str, NDArray[Any]]:
    """The fields of a PointCloud2 by name, row by row where it is organised; fields of several numbers are left out."""
    order = ">" if cloud.is_bigendian else "<"
    fields = [field for field in cloud.fields if field.count <= 1 and field.name and 1 <= field.datatype <= 8]
    layout = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [order + _NUMBERS[field.datatype - 1] for field in fields],
            "offsets": [field.offset for field in fields],
            "itemsize": cloud.point_step,
        }
    )
    row_step = cloud.row_step if cloud.height > 1 else cloud.width * cloud.point_step
    wanted = max(cloud.height - 1, 0) * row_step + cloud.width * cloud.point_step
    if len(cloud.data) < wanted or row_step < cloud.width * cloud.point_step:
        raise ScanError(
            f"{file}: expected {wanted} bytes in a cloud, got {len(cloud.data)} in rows of {row_step} "
            f"({cloud.height} x {cloud.width} points of {cloud.point_step})"
        )
    points = np.ndarray((cloud.height, cloud.width), layout, cloud.data, strides=(row_step, cloud.point_step))
    return {name: points[name].ravel() for name in layout.names or ()}
