"""Doubts, frame and causes of every input of a folder that was built after public bug reports.

python benchmarks/reports.py ../shared/data/reports
"""

import sys
from pathlib import Path

from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.settings import load


def main(folder):
    settings = load(None, [], preset="reference")
    print("| case | errors | warnings | Fix first |\n|---|---|---|---|")
    for case in sorted(path for path in folder.iterdir() if (path / "pairs.csv").exists()):
        found = check_dataset(case, settings)
        errors = "; ".join([*found.doubts, *found.faults]).replace(str(folder), "")
        warnings = "; ".join(found.warnings).replace(str(folder), "")
        causes = "; ".join(cause.words for cause in found.causes.causes)
        print(f"| {case.name} | {errors} | {warnings} | {causes} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
