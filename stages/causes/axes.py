"""Axes of the curves that show a cause."""

from __future__ import annotations

import numpy as np

from ...schemas.data_files import read_data

#: Axis of a curve by its kind: its label, that of the values, and the edges of its bins.
AXES = read_data("curves")
for axis in AXES.values():
    axis["edges"] = np.linspace(*axis["edges"])
