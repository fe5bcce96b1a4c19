"""Array types of the stages, and the hook for timing the steps of a stage.

A stage reads no clock. It enters `watch("step")` around each step worth timing; the caller decides what that does.
By default it does nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int32]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

Watch = Callable[[str], AbstractContextManager[None]]


def unwatched(step: str) -> AbstractContextManager[None]:
    """Do nothing: the default watch."""
    return nullcontext()
