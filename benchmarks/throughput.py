"""Pairs per minute on one worker and on two.

    python benchmarks/throughput.py DATASET

The same dataset, fresh, by each, once and with every pair listed twice: the pace is that of the further pairs, so that
start-up stands aside. Tables must be the same.
"""

import sys
from pathlib import Path

import pandas as pd
from measure import machine, repeated, scratch, weigh


def main(dataset):
    print(machine())
    with scratch() as folder:
        paces = {}
        tables = {}
        twice = None
        for workers in (1, 2):
            out = folder / f"workers{workers}"
            once = weigh("run", dataset, "--out", out, "--workers", workers, "--from", "ground")
            tables[workers] = pd.read_parquet(out / "pairs.parquet")
            n = len(tables[workers])
            twice = twice or repeated(dataset, 2 * n, folder / "twice")
            more = weigh(
                "run",
                twice,
                "--out",
                folder / f"twice{workers}",
                "--workers",
                workers,
                "--from",
                "ground",
            )
            paces[workers] = 60 * n / (more.wall_s - once.wall_s)
            print(f"workers {workers}: {paces[workers]:.1f} pairs per minute", flush=True)
    if not tables[1].equals(tables[2]):
        sys.exit("the tables differ")
    print(f"{paces[2] / paces[1]:.2f} times on two workers; the same tables")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
