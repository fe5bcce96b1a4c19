"""Pairs a minute on one worker and on two.

    python benchmarks/throughput.py DATASET

The same dataset, fresh, by each; start-up (a run with nothing to do) aside. Tables must be the same.
"""

import sys
from pathlib import Path

import pandas as pd
from measure import machine, scratch, weigh


def main(dataset):
    print(machine())
    with scratch() as folder:
        paces, tables = {}, {}
        for workers in (1, 2):
            out = folder / f"workers{workers}"
            run = weigh("run", dataset, "--out", out, "--workers", workers, "--from", "ground")
            idle = weigh("run", dataset, "--out", out, "--workers", workers)
            tables[workers] = pd.read_parquet(out / "pairs.parquet")
            paces[workers] = 60 * len(tables[workers]) / (run.wall_s - idle.wall_s)
            print(f"{workers} worker{'s' * (workers > 1)}: {paces[workers]:.1f} pairs a minute", flush=True)
    if not tables[1].equals(tables[2]):
        sys.exit("the tables differ")
    print(f"{paces[2] / paces[1]:.2f} times on two workers; the same tables")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
