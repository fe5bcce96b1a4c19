"""A finished run for the viewers of others: points and objects with their scores, as MCAP and as PLY.

MCAP: messages of sensor_msgs/PointCloud2 by ROS 2's names, written by rosbags. PLY: binary, with
scalar fields as CloudCompare names them. All numbers keep 64 bits.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.columns import SIDES
from ...schemas.errors import FidpipeError, RunError
from ...schemas.metric_catalogue import QUADRANT_SCORES, scores_in
from ...stages.coverage import nearest_distances
from ..storage.files import named_errors, write_whole
from ..storage.table_files import file_stem

if TYPE_CHECKING:
    import pandas as pd

    from ..results.finished import FinishedRun


#: Fate of the object that a point belongs to, by number; the first one is for points without an object.
STATUSES = ("ground", "scored", "identical", "too_small", "not_found", "extra")
LEGEND = ", ".join(f"{number} {status}" for number, status in enumerate(STATUSES))
_DRAWN = QUADRANT_SCORES[::-1]
#: Of a point: metres in the real sensor's frame; object (-1: ground); NaN without a score.
POINT = np.dtype(
    [
        *((name, "<f8") for name in ("x", "y", "z", *_DRAWN, "distance_m")),
        ("community", "<i4"),
        ("status", "u1"),
    ]
)
_SCORES = scores_in("export")
_COVERAGE = ("covered_0p3m", "median_distance_m")
#: Of an object, at its centroid: the columns of `metrics` and `coverage`; partner is -1 if absent.
OBJECT = np.dtype(
    [
        *((name, "<f8") for name in ("x", "y", "z", *_SCORES, *_COVERAGE)),
        *((name, "<i4") for name in ("community", "partner", "n_points")),
        ("status", "u1"),
    ]
)
TOPIC = "/fidpipe"
FRAME = "real_sensor"
_POINT_FIELDS = {"<i4": 5, "|u1": 2, "<f8": 8}  # PointField.INT32, UINT8, FLOAT64
_PLY_TYPES = {"<f8": "double", "<i4": "int", "|u1": "uchar"}
_NS = 1_000_000_000
_LATEST_S = 2**31  # seconds of a ROS stamp are int32

Message = tuple[str, int, NDArray[np.void] | str]  #: topic, nanoseconds, and points or text


def export_run(
    run: FinishedRun,
    folder: Path,
    pattern: str | None = None,
    *,
    mcap: bool = False,
    ply: bool = False,
    replace: bool = False,
    counted: Callable[[Sequence[str], int], Iterable[str]] = lambda names, n_names: names,
) -> list[str]:
    """Write the scored pairs of a run, one after the other: an MCAP file for all, a PLY file for each pair and side.

    The result is a line for each format that names its files.

    Parameters
    ----------
    folder : that they are written into
    pattern : only pairs whose name matches (shell style)
    replace : allow existing files to be replaced
    counted : yields the names of the pairs, whose number it is given, and shows progress

    Raises
    ------
    RunError
        No pair matches, a table is damaged, a file is in the way or cannot be written.
    FidpipeError
        rosbags is not installed.
    """
    if mcap and find_spec("rosbags") is None:
        raise FidpipeError(
            'writing MCAP needs rosbags, which is not installed; install it with: pip install "fidpipe[ros]"',
        )
    names = run.select(pattern)
    bag = folder / f"{run.folder.resolve().name}.mcap"
    plys = {}
    for name, side in product(names, SIDES):
        plys[name, side] = folder / f"{file_stem(name)}.{side}.ply"
    paths = list(plys.values()) if ply else []
    if mcap:
        paths.append(bag)
    for path in paths:
        if path.exists() and not replace:
            raise RunError(f"{path}: already exists; add --replace, or choose another --out")
    lines = []
    if mcap:
        stamps_ns, stamps = message_times(run, names)
        in_time = sorted(names, key=stamps_ns.__getitem__)
        _write_bag(bag, run, _messages(run, counted(in_time, len(names)), stamps_ns))
        lines.append(f"MCAP:   {bag}, stamps {stamps}")
    if ply:
        for name in counted(names, len(names)):
            for side, (points, _) in pair_clouds(run, name).items():
                write_whole(plys[name, side], _ply(run, name, side, points))
        lines.append(f"PLY:    {len(plys)} files in {folder}")
    return [*lines, f"pairs:  {len(names)}", f"status: {LEGEND}"]


def _messages(
    run: FinishedRun,
    names: Iterable[str],
    stamps_ns: dict[str, int],
) -> Iterator[Message]:
    for name in names:
        for side, (points, objects) in pair_clouds(run, name).items():
            yield f"{TOPIC}/{side}", stamps_ns[name], points
            yield f"{TOPIC}/{side}_objects", stamps_ns[name], objects
        yield f"{TOPIC}/scores", stamps_ns[name], json.dumps(run.row(name), allow_nan=False)


def message_times(run: FinishedRun, names: Sequence[str]) -> tuple[dict[str, int], str]:
    """The time of each pair in nanoseconds, and whose times these are.

    It is that of the real scan (`timestamp_s` of the manifest) if all these pairs have one, each
    its own, from 0 to 2^31 s. Else the pairs of the run are one second apart, the first at 1 s: to
    ROS, 0 means no time.
    """
    times_s = run.record.times_s
    known_s = {times_s[name] for name in names if 0 <= times_s.get(name, -1.0) < _LATEST_S}
    if len(known_s) == len(names):
        return {name: round(times_s[name] * _NS) for name in names}, "of the dataset"
    return {name: second * _NS for second, name in enumerate(run.names, 1)}, "one second apart"


def pair_clouds(
    run: FinishedRun,
    pair_id: str,
) -> dict[str, tuple[NDArray[np.void], NDArray[np.void]]]:
    """Points and objects of both sides of a scored pair: by side, (n,) of `POINT` and (c,) of `OBJECT`.

    `distance_m` is that of an object point to the nearest one of the other side, as in the table
    `coverage`. Objects without a point, as the reference preset has them on the simulated side,
    have no place and are left out.

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    objects = run.objects_of([pair_id]).rename(
        columns={"cx": "x", "cy": "y", "cz": "z", "community_id": "community"},
    )
    fate = objects["fate"].replace("remnant", "not_found")
    status = objects["status"].where(fate == "matched", fate)
    objects["status"] = status.map(STATUSES.index)
    frames = {side: run.points(pair_id, side) for side in SIDES}
    places = [
        rows.loc[~rows["is_ground"], ["x", "y", "z"]].to_numpy() for rows in frames.values()
    ]
    clouds = {}
    for (side, rows), distance_m in zip(
        frames.items(), nearest_distances(*places), strict=True
    ):
        rows.loc[~rows["is_ground"], "distance_m"] = distance_m
        side_objects = objects[objects["side"] == side]
        scores = side_objects[["community", *_DRAWN, "status"]]
        points = rows.assign(community=rows["community_id"].fillna(-1).astype(int))
        points = points.merge(scores, on="community", how="left").fillna({"status": 0})
        with_points = side_objects[side_objects["n_points"] > 0]
        clouds[side] = (_rows(points, POINT), _rows(with_points, OBJECT))
    return clouds


def _rows(frame: pd.DataFrame, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Columns of a data frame as a structured array."""
    return frame[list(dtype.names or ())].to_records(index=False).astype(dtype)


def _ply(run: FinishedRun, pair_id: str, side: str, points: NDArray[np.void]) -> bytes:
    of = f"{json.dumps(run.folder.resolve().name)}, pair {json.dumps(pair_id)}, side {side}, preset {run.preset}"
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment fidpipe export of {of}",
        "comment metres in the real sensor's frame; community -1 is ground; NaN without a score",
        f"comment status {LEGEND}",
        f"element vertex {len(points)}",
    ]
    for name in POINT.names or ():
        scalar = name if name in "xyz" else f"scalar_{name}"
        header.append(f"property {_PLY_TYPES[POINT[name].str]} {scalar}")
    header.append("end_header\n")
    return "\n".join(header).encode() + points.tobytes()


def _message(types: Any, content: NDArray[np.void] | str, time_ns: int) -> Any:
    """A text; or a PointCloud2 with a point for each row of an array, and a field for each of its columns."""
    if isinstance(content, str):
        return types["std_msgs/msg/String"](content)
    columns: Any = content.dtype.fields
    field = types["sensor_msgs/msg/PointField"]
    stamp = types["builtin_interfaces/msg/Time"](*divmod(time_ns, _NS))
    fields = []
    for name, (dtype, offset) in columns.items():
        fields.append(field(name, offset, _POINT_FIELDS[dtype.str], 1))
    return types["sensor_msgs/msg/PointCloud2"](
        header=types["std_msgs/msg/Header"](stamp, FRAME),
        height=1,
        width=len(content),
        fields=fields,
        is_bigendian=False,
        point_step=content.dtype.itemsize,
        row_step=content.nbytes,
        data=np.frombuffer(content.tobytes(), np.uint8),
        is_dense=True,
    )


def _write_bag(
    path: Path,
    run: FinishedRun,
    messages: Iterable[Message],
) -> None:
    """Write messages to an MCAP file, which appears once all are written."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}
    with named_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{path.name[:100]}.", dir=path.parent) as temporary:
            bag = Path(temporary) / "bag"
            writer = Writer(
                bag, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
            )
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            writer.set_custom_data(
                "fidpipe", f"{run.record.fidpipe}, preset {run.preset}, status {LEGEND}"
            )
            with writer:
                for topic, time_ns, content in messages:
                    message = _message(store.types, content, time_ns)
                    kind = message.__msgtype__
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=store)
                    writer.write(
                        connections[topic], time_ns, store.serialize_cdr(message, kind)
                    )
            with (bag / "bag.mcap").open("rb") as file:
                os.fsync(file.fileno())
            (bag / "bag.mcap").replace(path)
