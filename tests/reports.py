"""Names of pairs and classes that try to break what they are written into, and what a page holds."""

import base64
import io
import json
import re
import zlib

import numpy as np
from rich.console import Console

from fidpipe.pipeline.report.render import terminal

HOSTILE_PAIRS = (
    "<script>alert(1)</script>",
    "x" * 300,
    "../up & \"quoted\" 'it' $x_1$ {{report}} %s",
    "雪 \u202eabc\\u003c</bdi>",
)
HOSTILE_CLASS = "</script><img src=x onerror=alert(1)>"


def text_of(view, width=80, **options):
    """A view as a terminal of this width shows it."""
    console = Console(file=io.StringIO(), width=width, highlight=False, **options)
    console.print(terminal(view))
    return console.file.getvalue()


def embedded(page):
    """Data that the JavaScript of a page reads, from the page's text."""
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
