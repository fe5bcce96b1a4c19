"""Inputs that coverage guides: atheris changes them where that leads a reader or its library to lines not seen before.

    python tools/fuzz/guided.py [--inputs 100000] [--seconds 600] [--readers pcd,ply] [--out .cache/hostile]

It needs atheris (`pip install atheris`), and sees Python's lines alone, not those of libraries in C++ or Rust. An input
is a byte that says which file of which whole input is exchanged, then what that file holds. Those that led to new lines
stay in OUT/corpus/READER, and the next campaign begins with them.
"""

import argparse
import importlib
import inspect
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "tests")]

_MOST_INPUT_BYTES = 8192
#: Packages whose lines are followed, all of each: atheris knows no parts of them.
_FOLLOWED = ["fidpipe", "dpkt", "laspy", "pypcd4", "rosbags", "tomllib"]
#: Modules of larger packages, of which functions are followed.
_FOLLOWED_MODULES = ("trimesh.exchange.ply", "numpy.lib._format_impl")

#: An input of these takes too long: a folder of thirty files is written, read, and its ledger made again.
NOT_GUIDED = {"run folder"}


def guide(name, out, words):
    """Runs atheris on one reader in this process, which it ends."""
    import atheris

    warnings.simplefilter("ignore")
    scratch = Path(tempfile.mkdtemp(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None))
    tempfile.tempdir = str(scratch)
    with atheris.instrument_imports(include=_FOLLOWED):
        from attack import Judge, write_input
        from targets import TARGETS

        target = TARGETS[name]
        seeds = target.inputs()
        judge = Judge(target, seeds, scratch)
    for module in map(importlib.import_module, _FOLLOWED_MODULES):
        for function in filter(inspect.isfunction, list(vars(module).values())):
            if function.__module__ == module.__name__:
                atheris.instrument_func(function)
    places = [(seed, file) for seed in seeds for file in seed if file.startswith(target.hot)][:256]
    corpus, dictionary = out / "corpus" / name.replace(" ", "-"), scratch.with_suffix(".words")
    corpus.mkdir(parents=True, exist_ok=True)
    for number, (seed, file) in enumerate(places):
        (corpus / f"whole{number}").write_bytes(bytes([number]) + seed[file])
    escaped = ["".join(map("\\x{:02x}".format, word)) for word in target.words]
    dictionary.write_text("".join(f'"{word}"\n' for word in escaped or ["x"]))

    def test_one_input(content):
        which, content = content[:1] or b"\0", content[1:]
        seed, file = places[which[0] % len(places)]
        files = seed | {file: content}
        folder = scratch / f"input{judge.sums['inputs']}"  # what readers keep of a file, they keep by its name
        write_input(folder, files)
        fault, trace = judge(folder, sum(map(len, files.values())), 0)
        shutil.rmtree(folder)
        if fault:
            raise RuntimeError(f"{name}: {fault}\n{trace}")

    try:
        atheris.Setup([sys.argv[0], *words, f"-dict={dictionary}", str(corpus)], test_one_input)
        atheris.Fuzz()
    finally:
        shutil.rmtree(scratch)
        dictionary.unlink()


def campaign(name, n_inputs, seconds, out):
    """One reader in a process of its own: a row of figures, and what was found, if anything."""
    words = [sys.executable, __file__, "--one", name, "--inputs", str(n_inputs)]
    words += ["--seconds", str(seconds), "--out", str(out)]
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    began, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", env=env, check=False)
    seconds, used = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used
    said = re.findall(r"^#(\d+)\t(\w+)\s+cov: (\d+)", done.stderr, re.M)
    if not said:
        return "", done.stderr[-3000:]
    last_new = max((int(number) for number, kind, _ in said if kind == "NEW"), default=0)
    n_done, first, last = int(said[-1][0]), said[0][2], said[-1][2]
    row = f"| {name} | {n_done:,} | {first} to {last} | {last_new:,} | {n_done / seconds:.0f} | {used:.0f} |"
    return row, done.stderr[-3000:] if done.returncode else ""


def main():
    from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seconds", type=int, default=0, help="at most so many a reader; 0 for as many as it takes")
    parser.add_argument("--readers", default=",".join(name for name in TARGETS if name not in NOT_GUIDED))
    parser.add_argument("--out", type=Path, default=Path(".cache/hostile"))
    parser.add_argument("--one", help="used by itself: the reader of this process")
    wanted = parser.parse_args()
    words = [f"-runs={wanted.inputs}", f"-max_total_time={wanted.seconds}", f"-max_len={_MOST_INPUT_BYTES}"]
    words += ["-timeout=20", "-rss_limit_mb=1024"]
    wanted.out.mkdir(parents=True, exist_ok=True)
    if wanted.one:
        out = wanted.out.resolve()
        guide(wanted.one, out, [*words, f"-artifact_prefix={out}/guided-{wanted.one.replace(' ', '-')}-"])
    failed = []
    print("| reader | inputs | branches | last new one at input | inputs/s | processor, s |\n|---|---|---|---|---|---|")
    for name in wanted.readers.split(","):
        row, finding = campaign(name, wanted.inputs, wanted.seconds, wanted.out)
        print(row, finding, sep="\n" * bool(finding), flush=True)
        failed += [name] * bool(finding)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
