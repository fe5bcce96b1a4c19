"""A campaign of hostile inputs: for each reader so many, in a process of its own that is watched and may be ended.

    python tools/fuzz/campaign.py [--inputs 100000] [--readers pcd,ply] [--out .cache/hostile]

A reader that ends its process, never comes back, or takes too much memory is found, and the input with it; the campaign
goes on behind it. What is found lies in OUT/READER/NUMBER, and is made again by its number. `summary.json` and a table
in Markdown say how many inputs were read, refused, and how it went.
"""

import argparse
import json
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "tests")]

#: Seconds of the processor after which an input counts as one that never ends; of the clock, ten times as many.
SECONDS_TO_HANG = 20.0
_SUMS = ("inputs", "read", "refused")


def campaign(name, n_inputs, first=0):
    """Findings and sums of one reader.

    Parameters
    ----------
    first : number of the first input
    """
    from targets import TARGETS

    findings, sums = [], dict.fromkeys(_SUMS, 0) | {"slowest_s": 0.0, "grown_mib": 0.0, "ended": 0}
    start, stop = first, first + n_inputs
    while start < stop:
        with tempfile.TemporaryDirectory(dir=_fast_folder()) as place:
            words = [sys.executable, HERE / "attack.py", place, name, str(start), str(stop)]
            env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
            with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as complained:
                process = subprocess.Popen(words, stdout=said, stderr=complained, env=env)
                hung = _watch(process, Path(place) / "number")
                said.seek(0), complained.seek(0)
                lines, error = list(map(json.loads, said)), complained.read()
            at_work = _at_work(Path(place) / "number")
        findings += [line for line in lines if "fault" in line]
        ends = [line for line in lines if "inputs" in line]
        for end in ends:
            for key in _SUMS:
                sums[key] += end[key]
            sums["slowest_s"] = max(sums["slowest_s"], end["slowest_s"])
            sums["grown_mib"] = max(sums["grown_mib"], end["grown_mib"])
        if ends:
            break
        if at_work is None:
            raise RuntimeError(f"{name}: the process ended before its first input: {error[-2000:]}")
        fault = "never came back" if hung else f"the process ended with {process.returncode}"
        if hung or not TARGETS[name].in_worker:
            findings.append({"reader": name, "number": at_work, "fault": fault, "trace": error[-3000:]})
        sums["inputs"] += at_work + 1 - start
        sums["ended"] += 1
        start = at_work + 1
    return findings, sums


def _watch(process, number_file):
    """Waits for the process; ends it, and says True, where one input has it for too long."""
    last, since, clock = None, 0.0, time.monotonic()
    while process.poll() is None:
        time.sleep(0.05)
        at_work, used = _at_work(number_file), _processor_seconds(process.pid)
        if at_work != last or used is None:
            last, since, clock = at_work, used or 0.0, time.monotonic()
        elif at_work is not None and (
            used - since > SECONDS_TO_HANG or time.monotonic() - clock > 10 * SECONDS_TO_HANG
        ):
            process.kill()
            process.wait()
            return True
    return False


def _processor_seconds(pid):
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _at_work(number_file):
    """The number of the input that is being read; None before the first one."""
    try:
        (number,) = struct.unpack("<Q", number_file.read_bytes()[:8])
    except (OSError, struct.error):
        return None
    return number - 1 if number else None


def _fast_folder():
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def save(finding, out):
    """Writes the files of a finding and what was said of it."""
    from attack import make_input, write_input
    from targets import TARGETS

    target = TARGETS[finding["reader"]]
    folder = out / finding["reader"].replace(" ", "-") / str(finding["number"])
    shutil.rmtree(folder, ignore_errors=True)
    write_input(folder, make_input(target, target.inputs(), finding["reader"], finding["number"]))
    (folder / "finding.json").write_text(json.dumps(finding, indent=1))


def table(summary):
    """The summary in Markdown."""
    lines = [
        "| reader | inputs | read | refused | findings | slowest input, s | memory grown by, MiB |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, sums in summary["readers"].items():
        lines.append(
            f"| {name} | {sums['inputs']:,} | {sums['read']:,} | {sums['refused']:,} | {sums['findings']} | "
            f"{sums['slowest_s']:.3f} | {sums['grown_mib']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main():
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--readers", default=",".join(TARGETS))
    parser.add_argument("--out", type=Path, default=Path(".cache/hostile"))
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[1]
    machine = f"{os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    summary = {"machine": machine, "load": [load, load], "readers": {}}
    n_findings = 0
    for name in wanted.readers.split(","):
        findings, sums = campaign(name, wanted.inputs, wanted.first)
        for finding in findings[:50]:
            save(finding, wanted.out)
            print(f"{name} {finding['number']}: {finding['fault']}", file=sys.stderr, flush=True)
        summary["readers"][name] = sums | {"findings": len(findings)}
        summary["load"] = [min(summary["load"][0], os.getloadavg()[1]), max(summary["load"][1], os.getloadavg()[1])]
        n_findings += len(findings)
        (wanted.out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
        print(json.dumps({name: summary["readers"][name]}), file=sys.stderr, flush=True)
    print(
        f"{summary['machine']}, load {summary['load'][0]:.1f} to {summary['load'][1]:.1f}\n\n{table(summary)}", end=""
    )
    return 1 if n_findings else 0


if __name__ == "__main__":
    sys.exit(main())
