"""How faithful is this simulated LiDAR, and where does it fail?

Public names, loaded when first used:

evaluate_pair : one pair of scans in memory
open_run : the folder of a run, its tables as pandas frames
Settings : all settings of a run, with the paper's defaults
FidpipeError : what a wrong input or setting raises
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .pipeline.evaluate import PairResult, evaluate_pair
    from .pipeline.results.finished import FinishedRun, open_run
    from .schemas.errors import FidpipeError
    from .schemas.settings import Settings

__version__ = "0.1.0"
__all__ = ["FidpipeError", "FinishedRun", "PairResult", "Settings", "evaluate_pair", "open_run"]

_HOME = {
    "FidpipeError": ".schemas.errors",
    "FinishedRun": ".pipeline.results.finished",
    "PairResult": ".pipeline.evaluate",
    "Settings": ".schemas.settings",
    "evaluate_pair": ".pipeline.evaluate",
    "open_run": ".pipeline.results.finished",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name], __name__), name)
