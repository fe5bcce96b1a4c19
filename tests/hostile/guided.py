"""Inputs that coverage guides: atheris changes them where that leads a reader or its library to lines not seen before.

    python tests/hostile/guided.py [--inputs 100000] [--readers pcd,ply] [--out .cache/hostile]

It needs atheris (`pip install atheris`), and sees Python's lines alone, not those of libraries in C++ or Rust.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

_MOST_INPUT_BYTES = 8192
#: Packages whose lines are followed.
_FOLLOWED = ("fidpipe.pipeline.datasets", "fidpipe.pipeline.storage.bounds", "dpkt", "laspy", "pypcd4", "rosbags")
_FOLLOWED += ("trimesh.exchange.ply", "numpy.lib._format_impl")


def guide(name, words):
    """Runs atheris on one reader in this process, which it ends."""
    import atheris

    with atheris.instrument_imports(include=list(_FOLLOWED)):
        import fidpipe.pipeline.datasets.readers  # noqa: F401

        with tempfile.TemporaryDirectory() as folder:
            from attack import fault_of, write_input
            from seeds import TARGETS

            target = TARGETS[name]
            seeds = target.inputs()
            for seed in seeds:  # loads what is loaded at first use
                write_input(Path(folder), seed)
                target.read(Path(folder))
    hot = next(file for file in seeds[0] if file.startswith(target.hot))
    corpus, scratch = (Path(tempfile.mkdtemp()) for _ in range(2))
    for number, seed in enumerate(seeds):
        (corpus / f"whole{number}").write_bytes(seed[hot])
    n_inputs = 0

    def test_one_input(content):
        nonlocal n_inputs
        n_inputs += 1
        folder = scratch / str(n_inputs)
        write_input(folder, seeds[0] | {hot: content})
        try:
            target.read(folder)
        except Exception as error:
            if fault := fault_of(error):
                raise RuntimeError(f"{name}: {fault}") from error
        finally:
            for path in sorted(folder.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
            folder.rmdir()

    atheris.Setup([sys.argv[0], *words, str(corpus)], test_one_input)
    atheris.Fuzz()


def main():
    from seeds import TARGETS

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--readers", default=",".join(TARGETS))
    parser.add_argument("--out", type=Path, default=Path(".cache/hostile"))
    parser.add_argument("--one", help="used by itself: the reader of this process")
    wanted = parser.parse_args()
    words = [f"-runs={wanted.inputs}", f"-max_len={_MOST_INPUT_BYTES}", "-timeout=20", "-rss_limit_mb=1024"]
    wanted.out.mkdir(parents=True, exist_ok=True)
    if wanted.one:
        guide(wanted.one, [*words, f"-artifact_prefix={wanted.out}/guided-{wanted.one.replace(' ', '-')}-"])
    failed = []
    for name in wanted.readers.split(","):
        own = [sys.executable, __file__, "--one", name, "--inputs", str(wanted.inputs), "--out", str(wanted.out)]
        env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        done = subprocess.run(own, capture_output=True, text=True, env=env, check=False)
        n_done = re.findall(r"^#(\d+)", done.stderr, re.M) or ["0"]
        print(f"{name}: {n_done[-1]} inputs, {'no fault' if not done.returncode else done.stderr[-3000:]}", flush=True)
        failed += [name] * bool(done.returncode)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
