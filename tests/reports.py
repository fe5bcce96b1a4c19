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
    return json.loads(
        re.search(r'<script type="application/json" id="report">(.*?)</script>', page, re.S)[1]
    )


def unpacked(text, dtype=np.uint8):
    """A packed array of a page, as the browser reads it."""
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype)


def points_in(view, side, name="objects"):
    """(n, 3) metres, object points of a side in a page, or its road points (`name="road"`)."""
    packed = view["sides"][side]
    points = unpacked(packed["points"], "<i2").reshape(3, -1).T * view["step_m"]
    n_objects = sum(packed["counts"])
    return points[n_objects:] if name == "road" else points[:n_objects]
