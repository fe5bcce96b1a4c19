"""MCAP recordings of other writers than ROS 2, such as Foxglove's: point clouds in protobuf; read by mcap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ....schemas.errors import ScanError
from .scan import packed_columns

#: The message type of a point cloud.
CLOUD = "foxglove.PointCloud"
_ENCODINGS = ("protobuf", "cdr")
#: PackedElementField.UINT8 is 1, and so on.
_NUMBERS = (
    "u1",
    "i1",
    "u2",
    "i2",
    "u4",
    "i4",
    "f4",
    "f8",
)


class Connection(NamedTuple):
    """A topic of a recording.

    msgtype : name of the schema, with the encoding if it is neither protobuf nor that of ROS 2
    schema : record of the schema, which has its definition
    """

    topic: str
    msgtype: str
    schema: Any


class Recording:
    """An open recording with the interface of the readers of rosbags.

    connections : of all topics
    """

    def __init__(self, file: Path, reader: Any) -> None:
        self._reader = reader
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ScanError(
                f"{file}: expected a summary at its end, got none; the file is truncated: mcap recover it",
            )
        self.connections = []
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            msgtype = schema.name if schema else "no schema"
            if channel.message_encoding not in _ENCODINGS:
                msgtype = f"{msgtype}, {channel.message_encoding}"
            self.connections.append(Connection(channel.topic, msgtype, schema))

    def messages(
        self,
        connections: Sequence[Connection],
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages of one topic in order of time, from `start` to before `stop`, nanoseconds."""
        topic = connections[0].topic
        for _, _, message in self._reader.iter_messages(
            topic,
            starting_at=start,
            ending_before=stop,
        ):
            yield connections[0], message.log_time, message.data


@contextmanager
def opened(file: Path) -> Iterator[Recording]:
    """The recording in a file; it is closed at the end of the context."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        yield Recording(file, make_reader(stream))


def cloud_of(
    file: Path,
    connection: Connection,
    content: bytes,
) -> dict[str, NDArray[Any]]:
    """The fields of a point cloud by name; its pose is not applied."""
    from mcap_protobuf.decoder import DecoderFactory

    decode = DecoderFactory().decoder_for("protobuf", connection.schema)
    if decode is None:
        raise ScanError(
            f"{file}: topic {connection.topic}: expected a protobuf schema, got {connection.schema.encoding}",
        )
    cloud = decode(content)
    stride = cloud.point_stride
    if len(cloud.data) % stride:
        raise ScanError(
            f"{file}: expected points of {stride} bytes in a cloud, got {len(cloud.data)} bytes",
        )
    known = [field for field in cloud.fields if 1 <= field.type <= len(_NUMBERS)]
    fields = [(field.name, f"<{_NUMBERS[field.type - 1]}", field.offset) for field in known]
    return packed_columns(fields, cloud.data, (len(cloud.data) // stride,), (stride,))
