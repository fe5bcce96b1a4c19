"""A small finished run to report on, with names of pairs and classes that try to break what they are written into."""

import base64
import csv
import json
import re
import zlib

import numpy as np

from fidpipe.schemas.settings import load
from runs import run
from scenes import box, drifted, street, write_bin

HOSTILE_PAIRS = (
    "<script>alert(1)</script>",
    "x" * 300,
    "../up & \"quoted\" 'it' $x_1$ {{report}} %s",
    "雪 \u202eabc\\u003c</bdi>",
)
HOSTILE_CLASS = "</script><img src=x onerror=alert(1)>"


def finished_run(folder):
    """The folder of a run of four small labelled pairs under the hostile names, and a fifth one that fails."""
    dataset = folder / "dataset"
    rows = []
    for i, name in enumerate((*HOSTILE_PAIRS, "broken <b>pair</b>")):
        real = street(seed=10 * i)
        sides = {"real": real, "sim": drifted(real, seed=i, keep=0.9 - 0.1 * i)}
        for side, points in sides.items():
            write_bin(dataset / side / f"{i}.bin", points)
            labels = np.where(points[:, 0] > 0, 1, 2).astype("<u4")
            labels.tofile(dataset / side / f"{i}.label")
        rows.append([name, f"real/{i}.bin", f"sim/{i}.bin"])
    (dataset / "sim" / "4.bin").write_bytes(b"")
    (dataset / "labels.toml").write_text(f"1 = '{HOSTILE_CLASS}'\n2 = 'wall'\n")
    with (dataset / "pairs.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["pair_id", "real", "sim"], *rows])
    run(dataset, folder / "run")
    return folder / "run"


def reference_run(folder):
    """The folder of a run of two pairs under the preset `reference`.

    Of a pole three points are simulated, and a box is invented.
    """
    for i in range(2):
        real = street(seed=10 * i)
        invented = box([14, 14, 1], [1, 1, 1], 40, i)
        write_bin(folder / "dataset" / "real" / f"{i}.bin", real)
        write_bin(folder / "dataset" / "sim" / f"{i}.bin", np.vstack([drifted(real, seed=i), real[-3:], invented]))
    run(folder / "dataset", folder / "run", load(None, ["graph.k=20"], preset="reference"))
    return folder / "run"


def embedded(page):
    """What the JavaScript of a page reads, from the page's text."""
    return json.loads(re.search(r'<script type="application/json" id="report">(.*?)</script>', page, re.S)[1])


def unpacked(view):
    """The columns of a pair in a page by name, as the browser unpacks them."""
    columns, content = {}, zlib.decompress(base64.b64decode(view["packed"]["deflated"]))
    for name, width, n in view["packed"]["parts"]:
        part, content = content[: width * n], content[width * n :]
        if width == 1:
            columns[name] = np.frombuffer(part, np.uint8)
        else:
            steps = [sum(part[k * n + i] << (8 * k) for k in range(width)) for i in range(n)]
            sums = np.cumsum(steps) % 2 ** (8 * width)
            columns[name] = np.where(sums >= 2 ** (8 * width - 1), sums - 2 ** (8 * width), sums)
    assert content == b""
    return columns


def points_in(view, name):
    """(n, 3) metres, points of a pair in a page: "real", "sim", "real_road", "sim_road"."""
    columns = unpacked(view)
    return np.column_stack([columns[f"{name}_{axis}"] for axis in "xyz"]) * view["step_m"]
