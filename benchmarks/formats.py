"""What is read of each kind of file, and how fast?

    python benchmarks/formats.py ../shared/data      # the table of docs/formats.md

Every scan of the folder, and every frame of its recordings. Seconds: of the second reading of a file or frame, so that
libraries are loaded and the file is in memory; the time to find the frames of a recording stands beside it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path

from fidpipe.pipeline.datasets.pairs import scans_of
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref

FIELDS = ("intensity", "rings", "times_s", "instances", "labels")


def timed(call):
    start = time.perf_counter()
    result = call()
    return result, time.perf_counter() - start


def fields_of(scan):
    return " ".join(["x y z", *(name for name in FIELDS if getattr(scan, name) is not None)])


def sources(folder):
    """The scans of a folder; of a bag of ROS 2 its folder and the file in it."""
    return [
        path for path in sorted(folder.rglob("*")) if scan_ref(path).suffix not in ("", ".csv")
    ]


def main(folder):
    print("| file | format | frames | points | fields | s a frame | s to list |")
    print("|---|---|---|---|---|---|---|")
    for path in sources(folder):
        known = scan_ref(path)
        frames, to_list = timed(lambda path=path: scans_of(path))
        counts = []
        seconds = []
        for frame in frames:
            read_scan(frame)
            scan, took = timed(lambda frame=frame: read_scan(frame))
            counts.append(len(scan.points))
            seconds.append(took)
        points = str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
        listed = f"{to_list:.3f}" if known.format.holds_frames else ""
        columns = [
            path.relative_to(folder),
            f"`{known.suffix}`",
            len(frames),
            points,
            fields_of(scan),
        ]
        print(
            "|",
            " | ".join(map(str, [*columns, f"{sum(seconds) / len(seconds):.3f}", listed])),
            "|",
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
