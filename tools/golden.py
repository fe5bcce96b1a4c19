"""The numbers that the tiny dataset must give. `python tools/golden.py` renews them, and says which stages changed.

It refuses where numbers of a stage changed and its code version in `pipeline/jobs` did not.
"""

import json
import sys
import tempfile
from pathlib import Path

import pandas as pd

from fidpipe.pipeline.jobs import STAGES
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.rays import find_rays, score_rays
from fidpipe.stages.sensor_description import describe_sensor, sensor_row

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from runs import run
from scenes import write_dataset

FILE = Path(__file__).parents[1] / "tests" / "golden.json"
RELATIVE, ABSOLUTE = 1e-6, 1e-9


def measure():
    """Code version and numbers of every stage, from a run over two small streets."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = write_dataset(Path(folder) / "streets", 2)
        out = Path(folder) / "run"
        rows = run(dataset, out).rows
        frames = {stage.name: pd.read_parquet(out / stage.name) for stage in STAGES}
        objects = pd.read_parquet(out / "objects")
    streets = make_pair(0, 0, SENSORS["vlp16"], 20_000)
    real = streets.real.rows[:, :3].astype(float)
    sim = streets.sim.rows[:, :3].astype(float)
    sensors = [describe_sensor(points) for points in (real, sim)]
    rays = find_rays(real, sim, tuple(sensors))
    numbers = {
        "ground": [
            [
                row[name]
                for name in row
                if "ground_" in name or name.endswith(("_raw", "_clean"))
            ]
            for row in rows
        ],
        "sensor": [
            [
                value
                for value in sensor_row(sensors[0]).values()
                if isinstance(value, int | float)
            ]
        ],
        "graph": frames["graph"]
        .groupby(["pair_id", "side"])[["src", "dst", "length_m"]]
        .sum()
        .astype(float),
        "communities": objects.drop(columns=["pair_id", "side", "label"]).astype(float),
        "matching": frames["matching"][["real_id", "sim_id", "centroid_distance_m"]]
        .astype(float)
        .fillna(-1.0),
        "coverage": frames["coverage"]
        .drop(columns=["pair_id", "side"])
        .astype(float)
        .fillna(-1.0),
        "surface": frames["surface"].drop(columns=["pair_id"]).astype(float).fillna(-1.0),
        "pieces": frames["pieces"]
        .drop(columns=["pair_id", "side", "label", "fate"])
        .astype(float)
        .fillna(-1.0),
        "rays": [[*score_rays(rays).values()]],
        "causes": frames["causes"][["amount"]].round(4).fillna(-1.0),
        "selection": frames["selection"]
        .groupby(["pair_id", "real_id"])[["real_influence", "sim_influence"]]
        .sum(),
        "metrics": frames["metrics"]
        .drop(columns=["pair_id", "status", "reason"])
        .astype(float),
    }
    return {
        stage.name: {
            "version": stage.version,
            "numbers": of
            if isinstance(of := numbers[stage.name], list)
            else of.to_numpy().tolist(),
        }
        for stage in STAGES
    }


def differs(a, b):
    """True unless two lists of rows of numbers agree within the tolerances."""
    return len(a) != len(b) or any(map(row_differs, a, b))


def row_differs(x, y):
    return len(x) != len(y) or any(
        abs(p - q) > ABSOLUTE + RELATIVE * abs(q) for p, q in zip(x, y, strict=True)
    )


def renew():
    old = json.loads(FILE.read_text()) if FILE.exists() else {}
    new = measure()
    was_raised = False  # what comes after a stage with new numbers has new numbers too
    for stage, of in new.items():
        was_raised |= stage in old and of["version"] != old[stage]["version"]
        if stage in old and differs(of["numbers"], old[stage]["numbers"]):
            if not was_raised:
                sys.exit(
                    f"numbers of stage {stage} changed; raise its version in pipeline/jobs, say why in CHANGELOG.md"
                )
            print(f"stage {stage}: new numbers under version {of['version']}")
    FILE.write_text(json.dumps(new, indent=1) + "\n")


if __name__ == "__main__":
    renew()
