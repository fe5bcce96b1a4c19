"""Three builds of a simulator with known flaws, for docs/decision.md: python tools/builds.py FOLDER.

build41 is `fidpipe synth`; build42 is 12 cm lower and has 2 cm of range noise, as the real scans have; build43 has the
noise alone.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

#: Range noise (std) and shift along z of the simulated scans of each build, metres.
FLAWS = {"build42": (0.02, -0.12), "build43": (0.02, 0.0)}


def write_build(source, build, noise_m, shift_z_m):
    """Copy a dataset and change its simulated scans."""
    shutil.copytree(source, build)
    rng = np.random.default_rng(0)
    for path in sorted((build / "sim").glob("*.bin")):
        scan = np.fromfile(path, np.float32).reshape(-1, 4)
        range_m = np.linalg.norm(scan[:, :3], axis=1, keepdims=True)
        scan[:, :3] *= 1 + noise_m * rng.standard_normal((len(scan), 1)) / range_m
        scan[:, 2] += shift_z_m
        scan.tofile(path)


def main(folder):
    """Write the three datasets into a folder."""
    first = folder / "build41"
    subprocess.run(
        ["fidpipe", "synth", str(first), "--pairs", "8", "--points", "20000"], check=True
    )
    for name, (noise_m, shift_z_m) in FLAWS.items():
        write_build(first, folder / name, noise_m, shift_z_m)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
