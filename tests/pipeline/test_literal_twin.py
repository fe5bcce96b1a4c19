"""Whole runs under every setting that matters, each number computed again by the literal twin."""

import re
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.verify.verify import verify_run
from fidpipe.schemas.settings import load
from runs import run, some_of
from scenes import box, degenerate, drifted, moved, rigid, street, write_bin, write_pair

#: Those of which the choices below have none.
ALONE = [
    "graph.k=1",
    "graph.k=2000",
    "graph.tau_m=1.5",
    "communities.backend=python-louvain",
    "ground.method=none",
    "ground.method=patchwork",
    "ground.prior_m=1.1",
    "ground.max_variance_loss=0.0001",
    "input.exclude_box=5 -3 -9 11 6 9",
    "input.include_box=-14 -14 -3 12 12 5",
    "input.max_range_m=12",
    "metrics.baselines=all",
    "stability.seeds=2",
]
REFERENCE = [
    "communities.reach_m=0.25",
    "communities.reach_m=30",
    "communities.min_points=1",
    "communities.min_points=60",
    "communities.reference=labels",
    "communities.reference=instances",
    "ground.shared=true",
    "ground.method=none",
]
#: Those that no random choice below has, and that change other code than a number.
FEW_ALONE = ["communities.backend=python-louvain", "metrics.baselines=all", "stability.seeds=2", "ground.method=none"]
FEW_OF_REFERENCE = ["communities.reference=instances", "ground.shared=true"]
CHOICES = {
    "graph.k": (3, 25, 90),
    "graph.tau_m": (0, 0.2, 0.8),
    "graph.edges": ("union", "intersection"),
    "graph.ties": ("point_id", "coordinates"),
    "communities.seed": (0, 5),
    "communities.objects": ("independent", "reference"),
    "communities.reach_m": (0.4, 1.0, 3.0),
    "communities.min_points": (1, 8, 25),
    "matching.delta_m": (1.0, 5.0, 40.0),
    "matching.method": ("greedy", "optimal"),
    "selection.t": (0.2, 1.0, 6.0),
    "ground.loss": ("removed", "total"),
    "ground.shared": ("true", "false"),
    "ground.peak": ("own", "real"),
    "ground.prior_m": (0.0, 0.3),
}


def labelled(path, points):
    """Writes a scan with a class and a thing for each point: quadrants are classes, those with high points things."""
    write_bin(path, points)
    classes = (points[:, 0] > 0) + 2 * (points[:, 1] > 0) + 1
    things = np.where(points[:, 2] > -0.5, classes, 0)
    (things << 16 | classes).astype("<u4").tofile(path.with_suffix(".label"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """A street, a simulation of it that lacks some and has a box more, in another frame; all with labels."""
    folder = tmp_path_factory.mktemp("twin") / "street"
    real = np.vstack([street(seed=5), np.repeat(box([6, -4, 1], [1, 1, 1], 10, seed=1), 2, axis=0)])
    sim = np.vstack([drifted(real, seed=6), box([-16, -15, 2], [2, 2, 2], 50)])
    T = rigid(20, [1.0, -0.5, 0.1])
    seen = moved(sim - T[:, 3], np.column_stack([T[:, :3].T, np.zeros(3)]))
    labelled(folder / "real.bin", real)
    labelled(folder / "sim.bin", seen)
    cell = " ".join(repr(float(value)) for value in T.ravel())
    (folder / "pairs.csv").write_text(f"pair_id,real,sim,T_real_sim\nturned,real.bin,sim.bin,{cell}\n")
    return folder


def agree(dataset, out, settings, n_objects=None):
    """Runs and verifies; gives what was verified."""
    outcome = run(dataset, out, settings)
    assert not outcome.failures
    result = verify_run(out, n_objects)
    assert result.passed, result.mismatches
    assert result.n_scans == result.n_pairs > 0
    assert not any("cannot" in what for what in result.not_compared)
    return result


@pytest.mark.parametrize("word", some_of(["input.min_range_m=2.5", *ALONE], FEW_ALONE))
def test_each_side_by_itself_under_one_setting_after_the_other(dataset, tmp_path, word):
    if word == "ground.method=patchwork":
        pytest.importorskip("pypatchworkpp")
    result = agree(dataset, tmp_path / "run", load(None, [word]))
    is_told = any("patchwork" in what for what in result.not_compared)
    assert is_told == (word == "ground.method=patchwork")


@pytest.mark.parametrize("word", some_of(["input.min_range_m=2.5", *REFERENCE], FEW_OF_REFERENCE))
def test_objects_of_the_real_side_under_one_setting_after_the_other(dataset, tmp_path, word):
    agree(dataset, tmp_path / "run", load(None, [word], preset="reference"))


@pytest.mark.parametrize("seed", some_of(range(12), [2, 3]))
def test_settings_drawn_at_random_together(dataset, tmp_path, seed):
    rng = np.random.default_rng(seed)
    words = [f"{name}={rng.choice(values)}" for name, values in CHOICES.items()]
    agree(dataset, tmp_path / "run", load(None, words))


@pytest.mark.parametrize("word", ["input.sim_flip_y=true", "graph.ties=coordinates"])
def test_scans_with_many_equal_distances(tmp_path, word):
    grid = np.array([[x, y, z] for x in range(4) for y in range(4) for z in range(4)], dtype=float)
    others = np.vstack([grid * 0.5 + [-8, 3, 0], grid[:30] + [3, -9, 0]])
    write_pair(tmp_path / "grid", *(np.vstack([grid[:n] * 0.5 + [6, 4, -1], others]) for n in (64, 58)))
    result = agree(tmp_path / "grid", tmp_path / "run", load(None, [word, "ground.method=none", "graph.k=6"]))
    assert any("with ties among" in what for what in result.not_compared)


@pytest.mark.parametrize(
    ("preset", "every"),
    some_of(list(product(["paper", "reference"], [1, 4])), [("paper", 4), ("reference", 4)]),
)
def test_scenes_of_which_hardly_anything_can_be_said(tmp_path, preset, every):
    for i, scans in enumerate(list(degenerate().values())[::every]):
        for side, points in zip(("real", "sim"), scans, strict=True):
            (tmp_path / "scenes" / side).mkdir(parents=True, exist_ok=True)
            np.save(tmp_path / "scenes" / side / f"{i:02}.npy", points)
    settings = load(None, ["ground.method=none", "input.min_range_m=0"], preset=preset)
    assert run(tmp_path / "scenes", tmp_path / "run", settings).failures
    result = verify_run(tmp_path / "run", 60)
    assert result.passed, result.mismatches
    assert every > 1 or any("equal variance along two axes" in what for what in result.not_compared)


@pytest.mark.exhaustive
@pytest.mark.parametrize("preset", ["paper", "reference"])
@pytest.mark.parametrize(
    ("real", "sim", "every", "words"),
    [
        ("kitti_twin/real/000002.bin", "kitti_twin/sim/000002.bin", 4, ["graph.k=30", "matching.method=optimal"]),
        ("rellis/vel000104.bin", "rellis/000104.bin", 3, ["graph.edges=intersection", "selection.t=3"]),
    ],
)
def test_real_pairs(real_data, tmp_path, preset, real, sim, every, words):
    write_pair(tmp_path / "data", *(read_scan(real_data / name).points[::every] for name in (real, sim)))
    result = agree(tmp_path / "data", tmp_path / "run", load(None, words, preset=preset), n_objects=12)
    assert result.n_drawn == 12


ROOT = Path(__file__).parents[2]


def published(text):
    """Mean and deviation of each score in the row of a table of the README or of a page of the documentation."""
    lines = [
        line for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")) for line in page.read_text().splitlines()
    ]
    row = next(line for line in lines if line.startswith(f"| {text}"))
    return [(float(mean), float(std)) for mean, std in re.findall(r"([0-9.]+) ± ([0-9.]+)", row)]


@pytest.mark.exhaustive
def test_the_published_figures_of_kitti_are_those_of_the_literal_twin(real_data, tmp_path):
    out = tmp_path / "run"
    assert not run(real_data / "kitti_twin", out, workers=2).failures
    result = verify_run(out, 15)
    assert result.passed, result.mismatches
    assert (result.n_pairs, result.n_scans) == (5, 5)
    pairs = pd.read_parquet(out / "pairs.parquet")
    # Spectra of all objects take minutes: those of the drawn ones agree, and so do means with their objects.
    scores = pairs[["match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean"]]
    own = scores.agg(["mean", "std"]).T
    np.testing.assert_allclose(own, published("KITTI sequence 00 and a twin meshed"), atol=0.0005)
