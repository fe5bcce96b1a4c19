"""What `check`, `run` and `diagnose` say of every input of a folder that was built after public bug reports.

python benchmarks/reports.py ../shared/data/reports
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.open_run import open_run
from fidpipe.schemas.settings import load


def words(causes):
    return "; ".join(cause.words for cause in causes)


def evaluated(case, out):
    """Causes of a run and of its diagnosis, or why there are none."""
    command = ["fidpipe", "run", str(case), "--out", str(out), "--preset", "reference"]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        return "the pair fails", ""
    of_run = open_run(out).overview.causes
    subprocess.run(["fidpipe", "diagnose", str(out)], check=True, capture_output=True)
    return words(of_run), words(open_run(out).diagnosis.causes)


def main(folder):
    settings = load(None, [], preset="reference")
    print("| case | errors of `check` | warnings | `run` | `diagnose` |\n|---|---|---|---|---|")
    for case in sorted(path for path in folder.iterdir() if (path / "pairs.csv").exists()):
        checked = check_dataset(case, settings)
        errors = "; ".join([*checked.doubts, *checked.faults]).replace(str(folder), "")
        warnings = "; ".join(checked.warnings).replace(str(folder), "")
        with tempfile.TemporaryDirectory() as out:
            run, diagnosis = evaluated(case, Path(out) / case.name)
        print(f"| {case.name} | {errors} | {warnings} | {run} | {diagnosis} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
