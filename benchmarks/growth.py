"""How do time and memory grow with the points of a scan?

    python benchmarks/growth.py [POINTS ...]      by default 8000 15000 30000 60000 120000

One synthetic pair of a 64-beam sensor each, start-up aside, two workers; and what `machine.memory_gib` leaves: the
largest pair once more in 8 GiB.
"""

import sys

import pandas as pd
from measure import machine, scratch, weigh

MEMORY_GIB = 8


def main(sizes):
    print(machine())
    print("points   objects pts  largest   wall s    CPU s   process peak MiB   all MiB")
    with scratch() as folder:
        for size in sizes:
            data = folder / f"points{size}"
            out = folder / f"run{size}"
            weigh("synth", data, "--pairs", 1, "--sensor", "hdl64", "--points", size)
            words = [
                "run",
                data,
                "--out",
                out,
                "--workers",
                2,
                "--set",
                f"machine.memory_gib={MEMORY_GIB}",
            ]
            run = weigh(*words, "--from", "ground")
            idle = weigh(*words)
            row = pd.read_parquet(out / "pairs.parquet").iloc[0]
            largest = pd.read_parquet(out / "metrics").n_keep.max()
            print(
                f"{row.n_real_raw:7d} {row.n_real_points:6d} {row.n_sim_points:6d}  {largest:6d} "
                f"{run.wall_s - idle.wall_s:8.1f} {run.cpu_s - idle.cpu_s:8.1f} {max(run.peaks):14.0f} "
                f"{sum(sorted(run.peaks)[-3:]):14.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]] or [8000, 15000, 30000, 60000, 120000])
