"""How faithful is this simulated LiDAR, and where does it fail?

Public names, loaded when first used:

evaluate_pair : one pair of scans in memory, as a `PairResult`
run : evaluates a dataset or two folders of scans, as a `Run`: its tables as pandas frames, and plots
compare : what got worse or better from one build to another, as a `Comparison`
diagnose : what fixing each cause of a run gains
open_run : the folder of a run, as a `Run`
read_scan : a scan file of any format, as a `Scan`
Settings : all settings of a run, with the paper's defaults
FidpipeError : the error that a wrong input or setting raises
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .pipeline.datasets.readers import read_scan
    from .pipeline.datasets.readers.scan import Scan
    from .pipeline.evaluate import PairResult, evaluate_pair
    from .pipeline.open_run import Run, open_run
    from .pipeline.python_api import compare, diagnose, run
    from .pipeline.results.compare import Comparison
    from .schemas.errors import FidpipeError
    from .schemas.settings import Settings

__version__ = "0.1.0"
__all__ = [
    "Comparison",
    "FidpipeError",
    "PairResult",
    "Run",
    "Scan",
    "Settings",
    "compare",
    "diagnose",
    "evaluate_pair",
    "open_run",
    "read_scan",
    "run",
]

_HOME = {
    "Comparison": ".pipeline.results.compare",
    "FidpipeError": ".schemas.errors",
    "FinishedRun": ".pipeline.results.finished",
    "PairResult": ".pipeline.evaluate",
    "Run": ".pipeline.open_run",
    "Scan": ".pipeline.datasets.readers.scan",
    "Settings": ".schemas.settings",
    "compare": ".pipeline.python_api",
    "diagnose": ".pipeline.python_api",
    "evaluate_pair": ".pipeline.evaluate",
    "open_run": ".pipeline.open_run",
    "read_scan": ".pipeline.datasets.readers",
    "run": ".pipeline.python_api",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name], __name__), name)


def __dir__() -> list[str]:
    return __all__
