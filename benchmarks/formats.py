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

from fidpipe.pipeline.datasets.readers import frames_of, holds_frames, read_scan, suffix_of

FIELDS = ("intensity", "rings", "times_s", "incidence", "instances", "labels")


def timed(call):
    start = time.perf_counter()
    result = call()
    return result, time.perf_counter() - start


def fields_of(scan):
    return " ".join(["x y z", *(name for name in FIELDS if getattr(scan, name) is not None)])


def sources(folder):
    """The scans of a folder; of a bag of ROS 2 its folder and the file in it."""
    return [path for path in sorted(folder.rglob("*")) if suffix_of(path) is not None and path.suffix != ".csv"]


def main(folder):
    print("| file | format | frames | points | fields | s a frame | s to list |")
    print("|---|---|---|---|---|---|---|")
    for path in sources(folder):
        frames, to_list = timed(lambda path=path: frames_of(path)) if holds_frames(path) else ([path], None)
        counts, seconds = [], []
        for frame in frames:
            read_scan(frame)
            scan, took = timed(lambda frame=frame: read_scan(frame))
            counts.append(len(scan.points))
            seconds.append(took)
        points = str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
        listed = "" if to_list is None else f"{to_list:.3f}"
        columns = [path.relative_to(folder), f"`{suffix_of(path)}`", len(frames), points, fields_of(scan)]
        print("|", " | ".join(map(str, [*columns, f"{sum(seconds) / len(seconds):.3f}", listed])), "|")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
