"""Files as others write them: bags by rosbags, captures as packets of UDP, LAS by laspy, CARLA's by its own format."""

import struct

import numpy as np

CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "velodyne_msgs/msg/VelodyneScan"
_NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
_PACKETS = {
    "velodyne_msgs/msg/VelodynePacket": "{time} stamp\nuint8[1206] data\n",
    SCAN: "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
}


FIELDS = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<u2"),
        ("t", "<u4"),
    ]
)


def rows(points, fields=FIELDS):
    """Records of points with other intensities, rings and times."""
    found = np.zeros(len(points), fields)
    for name, column in zip("xyz", points.T, strict=True):
        found[name] = column
    found["intensity"] = np.arange(len(points)) % 256
    found["ring"] = np.arange(len(points)) % 32
    found["t"] = np.arange(len(points)) * 1000
    return found


def typestore(is_ros1):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    for name, text in _PACKETS.items():
        text = text.format(time="time" if is_ros1 else "builtin_interfaces/Time")
        types.register(get_types_from_msg(text, name))
    return types


def header(types, time_ns):
    time = types.types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
    Header = types.types["std_msgs/msg/Header"]
    sequence = {"seq": 0} if "seq" in Header.__dataclass_fields__ else {}
    return Header(**sequence, stamp=time, frame_id="lidar")


def cloud(types, rows, time_ns=0, height=1, padding=0, big_endian=False):
    """A PointCloud2 of a structured array; `padding` bytes end each row of an organised one."""
    rows = rows.astype(rows.dtype.newbyteorder(">")) if big_endian else rows
    Field = types.types["sensor_msgs/msg/PointField"]
    fields = [
        Field(name, rows.dtype.fields[name][1], _NUMBERS[rows.dtype[name].str[1:]], 1)
        for name in rows.dtype.names
    ]
    lines = rows.reshape(height, -1)
    content = b"".join(line.tobytes() + bytes(padding) for line in lines)
    return types.types[CLOUD](
        header=header(types, time_ns),
        height=height,
        width=lines.shape[1],
        fields=fields,
        is_bigendian=big_endian,
        point_step=rows.dtype.itemsize,
        row_step=lines.shape[1] * rows.dtype.itemsize + padding,
        data=np.frombuffer(content, np.uint8),
        is_dense=False,
    )


def write_bag(path, messages, packed=None):
    """A bag by its suffix (.bag; or a folder, of mcap where its name says so); messages as (topic, time_ns, make).

    make : of the types, gives the message
    packed : compression of chunks: "BZ2" or "LZ4" in ROS 1, "ZSTD" or "LZ4" in mcap
    """
    from rosbags.rosbag1 import Writer as Ros1Writer
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Ros2Writer

    is_ros1 = path.suffix == ".bag"
    types = typestore(is_ros1)
    if is_ros1:
        writer = Ros1Writer(path)
    else:
        plugin = StoragePlugin.MCAP if "mcap" in path.name else StoragePlugin.SQLITE3
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
    if packed and is_ros1:
        writer.set_compression(Ros1Writer.CompressionFormat[packed])
    elif packed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat[packed])
    with writer as bag:
        connections = {}
        for topic, time_ns, make in messages:
            message = make(types)
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=types)
            content = (
                types.serialize_ros1(message, kind)
                if is_ros1
                else types.serialize_cdr(message, kind)
            )
            bag.write(connections[topic], time_ns, content)
    return path


def packets_message(types, packets):
    """A VelodyneScan of (seconds, bytes)."""
    Packet = types.types["velodyne_msgs/msg/VelodynePacket"]
    Time = types.types["builtin_interfaces/msg/Time"]
    listed = [
        Packet(Time(int(stamp), round(stamp % 1 * 1e6) * 1000), np.frombuffer(data, np.uint8))
        for stamp, data in packets
    ]
    return types.types[SCAN](header=header(types, 0), packets=listed)


def write_pcap(path, packets):
    """A capture of UDP datagrams of (seconds, bytes)."""
    content = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    for stamp, data in packets:
        udp = struct.pack(">HHHH", 2368, 2368, 8 + len(data), 0) + data
        ip = (
            struct.pack(
                ">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, bytes(4), bytes(4)
            )
            + udp
        )
        frame = bytes(12) + b"\x08\x00" + ip
        content += (
            struct.pack("<IIII", int(stamp), round(stamp % 1 * 1e6), len(frame), len(frame))
            + frame
        )
    path.write_bytes(content)
    return path


def write_las(
    path,
    points,
    intensity=0,
    classes=0,
    *,
    version="1.4",
    point_format=6,
    scale=0.001,
    offset=0.0,
):
    """A LAS file, or LAZ by its suffix."""
    import laspy

    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = [scale] * 3
    header.offsets = np.broadcast_to(offset, 3)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.intensity, las.classification = np.broadcast_arrays(intensity, classes, points[:, 0])[
        :2
    ]
    las.write(path)
    return path


def carla_ply(points, columns):
    """File contents as `save_to_disk` of CARLA writes them: carla/pointcloud/PointCloudIO.h, sensor/data/LidarData.h.

    columns : after x, y, z: I; or CosAngle, ObjIdx and ObjTag
    """
    kinds = {"ObjIdx": "uint32", "ObjTag": "uint32"}
    text = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    text += "".join(f"property float32 {name}\n" for name in "xyz")
    text += (
        "".join(f"property {kinds.get(name, 'float32')} {name}\n" for name in columns)
        + "end_header\n"
    )
    for row, point in enumerate(points):
        values = [f"{value:.4f}" for value in point]
        values += [
            str(each[row]) if name in kinds else f"{each[row]:.4f}"
            for name, each in columns.items()
        ]
        text += " ".join(values) + "\n"
    return text


def columns_of(scan):
    """The columns of a scan, bit by bit."""
    columns = {
        name: np.asarray(own) for name, own in vars(scan).items() if name != "label_names"
    }
    return {name: (own.dtype, own.shape, own.tobytes()) for name, own in columns.items()}


def write_foxglove(path, scans, encoding="protobuf"):
    """An MCAP file of structured arrays as foxglove.PointCloud on /lidar at 5 s, 6 s, ...; stamped 0.5 s later."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.writer import Writer

    numbers = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "f4": 7, "f8": 8}
    kinds = {"string": 9, "bytes": 12, "fixed32": 7, "int32": 5, "int64": 3}
    messages = {
        "Time": [("seconds", "int64"), ("nanos", "int32")],
        "PackedElementField": [("name", "string"), ("offset", "fixed32"), ("type", "int32")],
        "PointCloud": [
            ("timestamp", ".foxglove.Time"),
            ("frame_id", "string"),
            ("pose", "bytes"),
        ]
        + [
            ("point_stride", "fixed32"),
            ("fields", ".foxglove.PackedElementField"),
            ("data", "bytes"),
        ],
    }
    file = descriptor_pb2.FileDescriptorProto(
        name="foxglove.proto", package="foxglove", syntax="proto3"
    )
    for name, fields in messages.items():
        message = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields, start=1):
            added = message.field.add(
                name=field, number=number, label=3 if field == "fields" else 1
            )
            added.type = kinds.get(kind, 11)
            if kind.startswith("."):
                added.type_name = kind
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    PointCloud = message_factory.GetMessageClass(
        pool.FindMessageTypeByName("foxglove.PointCloud")
    )
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema_id = writer.register_schema("foxglove.PointCloud", encoding, schema)
        channel = writer.register_channel("/lidar", encoding, schema_id)
        for number, scan in enumerate(scans):
            cloud = PointCloud(
                frame_id="lidar", point_stride=scan.dtype.itemsize, data=scan.tobytes()
            )
            cloud.timestamp.seconds = 5 + number
            cloud.timestamp.nanos = 500_000_000
            for name in scan.dtype.names:
                kind = numbers[scan.dtype[name].str[1:]]
                cloud.fields.add(name=name, offset=scan.dtype.fields[name][1], type=kind)
            time_ns = (5 + number) * 10**9
            writer.add_message(channel, time_ns, cloud.SerializeToString(), time_ns)
        writer.finish()
    return path
