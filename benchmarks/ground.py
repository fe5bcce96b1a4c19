"""Errors of the simulated side's road peak: its own fullest window (paper), or following the real side's (reference).

    python benchmarks/ground.py ../shared/data --scores rellis --scores kitti

Each scan, as is and with its ground made hilly, is compared with itself re-measured with 3 cm noise and 3 % loss, and
one random half of it with the other half, re-measured likewise and lifted by -0.5 to 0.5 m. Largest error in metres of
5 seeds, and the largest angle between the sides' axes. With --scores, surface coverage and CDC of halves (not lifted)
whose own peak is off by more than 5 cm.
"""

import argparse
from pathlib import Path

import numpy as np

from fidpipe import evaluate_pair
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.settings import load
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.generate.second_measurement import remeasure
from fidpipe.stages.ground import remove_ground

SCANS = (
    *(
        "kitti_sequence/000000.bin",
        "kitti_twin/real/000000.bin",
        "rellis/vel000104.bin",
        "rellis/000104.bin",
    ),
    *("carla/000030.bin", "nuscenes/*.pcd.bin", "lumpi/real/0001.bin"),
)
GROUNDS = {
    "as is": lambda points: points,
    "every 8th row": lambda points: points[::8],
    "stripes 0.15 m lower": lambda points: (
        points - np.outer(points[:, 0] // 6 % 2, [0, 0, 0.15])
    ),
    "crest of 10 %": lambda points: points - np.outer(abs(points[:, 0]), [0, 0, 0.1]),
}
LIFTS_M = (0.0, -0.5, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.5)


def main() -> None:
    """Prints a row per scan and ground, and scores where they are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument(
        "--scores",
        action="append",
        default=[],
        help="also scores of scans with this in their name",
    )
    args = parser.parse_args()
    settings = load(None, preset="reference")
    with_peak = {
        peak: settings.ground.model_copy(update={"peak": peak}) for peak in ("own", "real")
    }
    print(
        "| scan | ground | own, re-measured | own, other half | real, re-measured | real, other half | axes (deg) |"
    )
    print("|---|---|---|---|---|---|---|")
    for pattern in SCANS:
        columns = ("x", "y", "z") if "lumpi" in pattern else None
        scan = clean_scan(
            read_scan(next(args.data.glob(pattern)), columns).points, settings.input
        ).points
        for name, change in GROUNDS.items():
            points = change(scan)
            errors_m = []
            angles_deg = []
            jumped = None
            for seed in range(5):
                rng = np.random.default_rng(seed)
                again = remeasure(points, 0.03, 0.03, rng)[0]
                is_first = rng.random(len(points)) < 0.5
                half = points[is_first]
                other = remeasure(points[~is_first], 0.03, 0.03, rng)[0]
                pairs = [
                    (points, again, 0.0),
                    *((half, other + np.array([0, 0, lift]), lift) for lift in LIFTS_M),
                ]
                for real, sim, lift_m in pairs:
                    cut = remove_ground(real, with_peak["own"])
                    own = remove_ground(sim, with_peak["own"])
                    expected_m = cut.peak_m + lift_m * cut.axis[2]
                    follows = remove_ground(sim, with_peak["real"], cut, real)
                    errors_m.append((own.peak_m - expected_m, follows.peak_m - expected_m))
                    angles_deg.append(np.degrees(np.arccos(min(1.0, cut.axis @ own.axis))))
                if abs(errors_m[1 - len(pairs)][0]) > 0.05:
                    jumped = half, other
            worst = np.abs(errors_m).reshape(5, -1, 2)
            cells = (*worst[:, 0].max(axis=0), *worst[:, 1:].max(axis=(0, 1)))
            lengths = (f"{cells[i]:.3f} |" for i in (0, 2, 1, 3))
            print(f"| {pattern} | {name} |", *lengths, f"{max(angles_deg):.2f} |", flush=True)
            for peak, ground in with_peak.items():
                if jumped and any(word in pattern for word in args.scores):
                    scores = evaluate_pair(
                        *jumped, settings.model_copy(update={"ground": ground})
                    ).summary
                    print(
                        f"peak {peak}:",
                        *(
                            f"{key} {scores[key]:.3f}"
                            for key in ("covered_real_0p3m", "cdc_mean")
                        ),
                    )


if __name__ == "__main__":
    main()
