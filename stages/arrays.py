"""Names for the array types of the stages, and the hook by which a caller follows the steps of one.

A stage reads no clock. Where it has steps worth timing it enters `watch("step")` around each of them;
whoever calls decides what that does. By default it does nothing.
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
    """The watch that does nothing."""
    return nullcontext()
