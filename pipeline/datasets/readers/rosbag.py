"""ROS bags: ROS 1 `.bag`; ROS 2 folders with a `metadata.yaml`, `.db3` and `.mcap`; read by rosbags.

A frame is a message of sensor_msgs/PointCloud2, foxglove.PointCloud, or velodyne_msgs/VelodyneScan.
Its time is that of its recording.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ....schemas.errors import ScanError
from ...storage.files import file_marks
from . import foxglove
from .scan import Scan, packed_columns, scan_from_columns
from .scan_ref import ScanRef, frame_number

_CLOUD = "sensor_msgs/msg/PointCloud2"
_PACKETS = "velodyne_msgs/msg/VelodyneScan"
_PACKET = "velodyne_msgs/msg/VelodynePacket"
_DEFINITIONS = {
    _PACKETS: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    _PACKET: "time stamp\nuint8[1206] data\n",
}
_ROS2_PACKET = "builtin_interfaces/Time stamp\nuint8[1206] data\n"
_NUMBERS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # PointField.INT8 is 1, and so on


def read(frame: ScanRef) -> Scan:
    """One frame of a bag.

    Raises
    ------
    ScanError
        The bag is damaged, or has no such topic or frame, or several.
    """
    file = frame.file
    with _opened(frame) as bag:
        connection, content = _message(bag, replace(frame, topic=_topic(bag, frame)))
        if connection.msgtype == foxglove.CLOUD:
            return scan_from_columns(file, foxglove.cloud_of(file, connection, content))
        is_ros1 = _is_ros1(file)
        types = _types(is_ros1)
        deserialize = types.deserialize_ros1 if is_ros1 else types.deserialize_cdr
        message = deserialize(content, connection.msgtype)
        if connection.msgtype == _CLOUD:
            columns = _cloud_columns(file, message)
        else:
            from .velodyne import decoded

            packets = []
            for packet in message.packets:
                time_s = float(packet.stamp.sec + packet.stamp.nanosec * 1e-9)
                packets.append((time_s, packet.data.tobytes()))
            columns = decoded(file, packets)
    return scan_from_columns(file, columns)


def frames(recording: ScanRef) -> list[ScanRef]:
    """The frames of the topic, in order of time.

    Raises
    ------
    ScanError
        The bag is damaged, or has no such topic, or several.
    """
    with _opened(recording) as bag:
        named = replace(recording, topic=_topic(bag, recording))
    return [named.at(time_ns) for time_ns in _times_of(named)]


def _message(bag: Any, frame: ScanRef) -> tuple[Any, bytes]:
    """Connection and content of the message of a frame; the whole bag is read only if its time is not unique."""
    connections = _connections(bag, frame)
    time_ns = frame.time_ns
    messages = []
    if time_ns is not None:
        messages = list(bag.messages(connections, time_ns, time_ns + 1))
    if len(messages) != 1:
        times_ns = _times_of(frame)
        number = frame_number(frame, times_ns)
        time_ns = times_ns[number]
        messages = list(bag.messages(connections, time_ns, time_ns + 1))
        messages = messages[number - times_ns.index(time_ns) :]
    connection, _, content = messages[0]
    return connection, content


def _opened(recording: ScanRef) -> Any:
    """The bag's reader, a context."""
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    file = recording.file
    reader = Ros1Reader if _is_ros1(file) else Ros2Reader
    for path in recording.files:
        name = str(path.absolute())
        if name.endswith(".db3") and not {*"%?#"}.isdisjoint(name):
            raise ScanError(
                f"{name}: expected a path without %, ? and #, which SQLite reads as parts of an address",
            )
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


def _topic(bag: Any, scan: ScanRef) -> str:
    """The topic that is named, or the only one of point clouds, or else of packets."""
    types = {connection.topic: connection.msgtype for connection in bag.connections}
    clouds = [topic for topic, kind in types.items() if kind in (_CLOUD, foxglove.CLOUD)]
    packets = [topic for topic, kind in types.items() if kind == _PACKETS]
    candidates = clouds or packets
    if scan.topic is not None:
        candidates = [topic for topic in (*clouds, *packets) if topic == scan.topic]
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        listed = ", ".join(sorted(candidates))
        raise ScanError(
            f"{scan.file}: point clouds on {listed}; name one topic, such as "
            f"{scan.file.name}#{min(candidates)}@{scan.frame or 0}"
        )
    listed = ", ".join(sorted(f"{topic} ({kind})" for topic, kind in types.items()))
    raise ScanError(
        f"{scan.file}: expected {scan.topic or 'a topic'} of {_CLOUD}, {foxglove.CLOUD} or "
        f"{_PACKETS}, got {listed or 'no topics'}"
    )


def _times_of(recording: ScanRef) -> list[int]:
    """When each frame of the topic was recorded, in order."""
    return _times_ns(replace(recording, frame=None), tuple(map(file_marks, recording.files)))


@lru_cache(maxsize=16)
def _times_ns(recording: ScanRef, marks: tuple[str, ...]) -> list[int]:
    """See `_times_of`; reads the bag once while the marks of its files stay."""
    with _opened(recording) as bag:
        times_ns = [time_ns for _, time_ns, _ in bag.messages(_connections(bag, recording))]
    if not all(isinstance(time_ns, int) and time_ns >= 0 for time_ns in times_ns):
        raise ScanError(
            f"{recording.file}: expected a time in nanoseconds for each frame; a frame has none",
        )
    return times_ns


def _connections(bag: Any, scan: ScanRef) -> list[Any]:
    """The connections of a topic."""
    return [connection for connection in bag.connections if connection.topic == scan.topic]


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
    known = [
        field
        for field in cloud.fields
        if field.count <= 1 and 1 <= field.datatype <= len(_NUMBERS)
    ]
    fields = [
        (field.name, order + _NUMBERS[field.datatype - 1], field.offset) for field in known
    ]
    row_bytes = cloud.width * cloud.point_step
    row_step = cloud.row_step if cloud.height > 1 else row_bytes
    n_bytes = max(cloud.height - 1, 0) * row_step + row_bytes
    if len(cloud.data) < n_bytes or row_step < row_bytes:
        raise ScanError(
            f"{file}: expected {n_bytes} bytes in a cloud, got {len(cloud.data)} in rows of "
            f"{row_step} ({cloud.height} x {cloud.width} points of {cloud.point_step})"
        )
    shape = (cloud.height, cloud.width)
    return packed_columns(fields, cloud.data, shape, (row_step, cloud.point_step))
