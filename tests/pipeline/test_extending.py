"""The worked examples of docs/extending.md do what the page says, in the files that it names and no others."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from fidpipe.pipeline.datasets.readers import formats
from runs import JOBS_PER_PAIR, command, own_process
from scenes import drifted, street, write_bin

N_POINTS = 100

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
FILE = re.compile(r"`([\w/]+\.(?:py|csv))`")
COMMAND = "from fidpipe.pipeline.cli.main import main; main()"
MOST_FILES = {"A reader": 2, "A setting": 2, "A baseline metric": 3, "A score": 3, "A stage": 5}


def section_of(title):
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def blocks_of(title):
    """File and code of each block of Python or CSV of a section; the file is the one named last before it."""
    texts = re.split(r"```(?:python|csv)\n(.*?)```", section_of(title), flags=re.DOTALL)
    return [(FILE.findall("".join(texts[:i:2]))[-1], texts[i]) for i in range(1, len(texts), 2)]


def files_of(title):
    """The files that the numbered list of a section names, one for each line of it."""
    items = re.findall(
        r"^\d+\. (.*?)(?=^\d+\. |^$)", section_of(title), re.DOTALL | re.MULTILINE
    )
    return [named[0] for item in items if (named := FILE.findall(item))]


def written(text, block):
    """The file with a block in its place: between the lines at the block's beginning and end that the file has."""
    lines = block.splitlines(keepends=True)
    parts = ("".join(lines[:i] + lines[j:]) for i, j in combinations(range(len(lines) + 1), 2))
    known = max((part for part in parts if text.count(part) == 1), key=len, default="")
    return text.replace(known, block) if known else text + block


class Extended(NamedTuple):
    """A copy of the package with the examples of a section written into it."""

    folder: Path

    def start(self, *words):
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        call = list(map(str, words))
        return subprocess.run(
            call, capture_output=True, text=True, check=False, env=environment, cwd=self.folder
        )

    def fidpipe(self, *words, exit_code=0):
        """The command of the copy."""
        result = self.start(sys.executable, "-c", COMMAND, *words)
        assert result.returncode == exit_code, result.stdout + result.stderr
        return result

    def breaks_no_layer(self):
        """True if imports go downwards only, else the linter's output."""
        shutil.copy(ROOT / "pyproject.toml", self.folder)
        result = self.start(Path(sys.executable).with_name("lint-imports"), "--no-cache")
        return result.returncode == 0 or result.stdout


def extended(title, folder):
    """A copy of the package with the blocks of a section in their places; gives it with the files that were touched."""
    package = folder / "fidpipe"
    for part in ("pipeline", "schemas", "stages"):
        shutil.copytree(
            ROOT / part, package / part, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(ROOT / "__init__.py", package)
    touched = []
    for name, code in blocks_of(title):
        path = package / name
        path.write_text(written(path.read_text(), code) if path.exists() else code)
        touched.append(name)
    if title == "A score":
        path = package / files_of(title)[-1]
        text = path.read_text()
        (version,) = re.findall(r"\bversion=(\d+),", text)
        path.write_text(text.replace(f"version={version},", f"version={int(version) + 1},"))
        touched.append(files_of(title)[-1])
    for name in touched:
        if name.endswith(".py"):
            compile((package / name).read_text(), name, "exec")
    return Extended(folder), touched


@pytest.mark.parametrize("title", MOST_FILES)
def test_an_example_touches_the_files_that_its_section_names_and_they_are_few(title, tmp_path):
    _, touched = extended(title, tmp_path)
    files = files_of(title)
    assert sorted(set(touched)) == sorted(files)
    assert len(files) <= MOST_FILES[title]
    anchor = title.lower().replace(" ", "-")
    (row,) = [
        line for line in PAGE.splitlines() if line.startswith("|") and f"(#{anchor})" in line
    ]
    assert int(re.search(r"\| (\d)", row)[1]) == len(files)


def made_again(result):
    """The stages that the command says it replaces."""
    lines = [line for line in result.stderr.splitlines() if line.startswith("replacing ")]
    return {
        name
        for line in lines
        for name in re.search(r"replacing (.*?) of ", line)[1].split(", ")
    }


def test_the_setting_is_obeyed_checked_recorded_and_part_of_the_key(again, dataset, tmp_path):
    package, _ = extended("A setting", tmp_path)
    run = ("run", dataset, "--out", again, "--workers", 1)
    following = {
        "graph",
        "communities",
        "matching",
        "coverage",
        "surface",
        "selection",
        "metrics",
    }
    assert made_again(package.fidpipe(*run)) == following
    assert made_again(package.fidpipe(*run)) == set()
    result = package.fidpipe(*run, "--set", "graph.max_edge_m=0.5", "--replace")
    assert made_again(result) == following
    assert "graph.max_edge_m was None, is 0.5" in result.stderr
    assert pd.read_parquet(again / "graph").length_m.max() <= 0.5
    assert "max_edge_m = 0.5" in (again / "settings.toml").read_text()
    wrong = package.fidpipe(*run, "--set", "graph.max_edge_m=0", exit_code=1)
    assert wrong.stderr.startswith(
        "error: setting graph.max_edge_m: expected greater than 0, got 0"
    )


@pytest.mark.exhaustive
def test_the_baseline_is_computed_swept_and_timed(again, dataset, tmp_path):
    package, _ = extended("A baseline metric", tmp_path)
    assert package.breaks_no_layer() is True
    package.fidpipe(
        "run", dataset, "--out", again, "--workers", 1, "--set", "metrics.baselines=box_overlap"
    )
    rows, metrics = pd.read_parquet(again / "baselines"), pd.read_parquet(again / "metrics")
    assert rows.real_id.notna().sum() == len(metrics)
    ground = pd.read_parquet(again / "ground").query("not is_ground and pair_id == '000'")
    sides = ground.groupby("side")[["x", "y", "z"]]
    low = sides.min()
    high = sides.max()
    common = (high.min() - low.max()).clip(lower=0).prod()
    whole = rows[rows.real_id.isna() & (rows.pair_id == "000")].value.item()
    assert whole == pytest.approx(common / ((high - low).prod(axis=1).sum() - common))
    timings = pd.read_parquet(again / "timings.parquet").query("stage == 'baselines'")
    assert "box_overlap" in set(timings.step)
    words = ("--sweep", "dropout=0.4", "--repeats", 1, "--global-repeats", 0, "--workers", 1)
    package.fidpipe(
        "perturb",
        dataset,
        "--out",
        tmp_path / "perturb",
        "--set",
        "metrics.baselines=box_overlap",
        *words,
    )
    assert (
        pd.read_parquet(tmp_path / "perturb" / "perturb_baselines.parquet")
        .value.between(0, 1)
        .all()
    )


@pytest.mark.exhaustive
def test_the_score_is_in_every_table_and_nothing_stale_is_kept(again, dataset, tmp_path):
    package, _ = extended("A score", tmp_path)
    words = ("--sweep", "noise=0.01", "--repeats", 1, "--global-repeats", 1, "--workers", 1)
    perturb = ("perturb", dataset, "--out", tmp_path / "perturb", *words)
    assert own_process(*perturb).returncode == 0
    result = package.fidpipe("run", dataset, "--out", again, "--workers", 1, "--replace")
    assert made_again(result) == {"metrics"}
    assert "had other code of stage metrics" in result.stderr
    metrics = pd.read_parquet(again / "metrics").dropna(subset="laplacian_change")
    assert (metrics.frobenius_change >= metrics.laplacian_change - 1e-9).all()
    pairs = pd.read_parquet(again / "pairs.parquet").set_index("pair_id")
    means = pd.read_parquet(again / "metrics").groupby("pair_id").frobenius_change.mean()
    assert pairs.frobenius_change_mean.to_dict() == pytest.approx(means.to_dict())
    shutil.copytree(again, tmp_path / "copy")
    shown = ("show", again, "000", metrics.query("pair_id == '000'").real_id.iloc[0])
    for words in (
        ("show", again, "--all"),
        shown,
        ("compare", tmp_path / "copy", again, "--all"),
    ):
        assert "change, Frobenius" in package.fidpipe(*words).stdout, words
    assert '"frobenius_change": ' in package.fidpipe("show", again, "000", "--json").stdout
    package.fidpipe("report", again)
    assert "change, Frobenius" in (again / "report.html").read_text(encoding="utf-8")
    objects = "from fidpipe.pipeline.exchange.export import OBJECT; print(OBJECT.names)"
    assert "'frobenius_change'" in package.start(sys.executable, "-c", objects).stdout
    assert "replacing perturb of 1 pair" in package.fidpipe(*perturb, "--replace").stderr
    assert "frobenius_change_mean" in pd.read_parquet(
        tmp_path / "perturb" / "perturb_global.parquet"
    )
    scan = dataset / "real" / "000.bin"
    for side in ("real", "sim"):
        write_bin(
            tmp_path / "same" / side / "a.bin", np.fromfile(scan, "<f4").reshape(-1, 4)[:, :3]
        )
    package.fidpipe("run", tmp_path / "same", "--out", tmp_path / "identical", "--workers", 1)
    assert (
        pd.read_parquet(tmp_path / "identical" / "metrics").frobenius_change.dropna() == 0
    ).all()


@pytest.mark.exhaustive
def test_the_stage_is_made_shown_and_made_again_alone(again, dataset, tmp_path):
    package, _ = extended("A stage", tmp_path)
    assert package.breaks_no_layer() is True
    examples = "import doctest, fidpipe.stages.neighbours as own; print(doctest.testmod(own), own.__file__)"
    shown = package.start(sys.executable, "-c", examples).stdout
    assert shown.startswith(f"TestResults(failed=0, attempted=1) {package.folder}")
    run = ("run", dataset, "--out", again)
    result = package.fidpipe(*run, "--workers", 1)
    assert made_again(result) == set()
    assert f"4 jobs done, {2 * JOBS_PER_PAIR} reused" in result.stdout
    objects = pd.read_parquet(again / "objects")
    rows = pd.read_parquet(again / "neighbours")
    assert len(rows) == len(objects)
    for (pair_id, side), own in objects.groupby(["pair_id", "side"]):
        centroids = own.sort_values("community_id")[["cx", "cy", "cz"]].to_numpy()
        apart = np.linalg.norm(centroids[:, None] - centroids[None], axis=2) + np.diag(
            np.full(len(own), np.inf)
        )
        nearest = (
            rows[(rows.pair_id == pair_id) & (rows.side == side)]
            .sort_values("community_id")
            .nearest_m
        )
        np.testing.assert_allclose(
            nearest, np.where(apart.min(axis=1) <= 20, apart.min(axis=1), np.nan)
        )
    assert "nearest" in set(
        pd.read_parquet(again / "timings.parquet").query("stage == 'neighbours'").step
    )
    assert re.search(
        r"finished for all pairs: .*neighbours", package.fidpipe("status", again).stdout
    )
    assert made_again(
        package.fidpipe(*run, "--workers", 1, "--set", "neighbours.within_m=5", "--replace")
    ) == {"neighbours"}
    package.fidpipe("run", dataset, "--out", tmp_path / "two", "--workers", 2)
    package.fidpipe(*run, "--workers", 1, "--replace")
    for path in (tmp_path / "two" / "neighbours").iterdir():
        assert pq.read_table(path).equals(pq.read_table(again / "neighbours" / path.name))


def write(folder, save):
    """One small pair, as a writer of some format saves it."""
    scan = street()
    for side, points in (("real", scan), ("sim", drifted(scan))):
        (folder / side).mkdir(parents=True)
        save(folder / side / "a", points.astype(np.float32))
    return folder


def test_a_new_format_is_checked_and_gives_the_numbers_of_a_known_one(tmp_path):
    package, _ = extended("A reader", tmp_path)

    def as_text(stem, points):
        np.savetxt(f"{stem}.xyz", points.astype(np.float64), fmt="%.17g")

    streets = {
        name: write(tmp_path / name, save)
        for name, save in (("xyz", as_text), ("npy", np.save))
    }
    assert "no scan pairs found" in command("check", streets["xyz"]).stderr
    assert "1 of 1 pairs can be evaluated" in package.fidpipe("check", streets["xyz"]).stdout
    for name, dataset in streets.items():
        package.fidpipe("run", dataset, "--out", tmp_path / f"run-{name}", "--workers", 1)
    for table in ("objects/a.real", "objects/a.sim", "metrics/a"):
        new, known = [
            pq.read_table(tmp_path / f"run-{name}" / f"{table}.parquet") for name in streets
        ]
        assert new.num_rows
        assert new.equals(known)
    (streets["xyz"] / "sim" / "a.xyz").write_text("1 2\n3 4\n")
    shown = package.fidpipe("check", streets["xyz"], exit_code=1)
    assert "a.xyz: expected 3 columns" in shown.stdout


@pytest.fixture
def pts_package(tmp_path):
    """The documented package, as pip lays it out: its module, and metadata from its pyproject.toml."""
    section = section_of("A reader in another package")
    site = tmp_path / "site"
    (project,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    (module,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    metadata = site / "fidpipe_pts-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: fidpipe-pts\nVersion: 1.0\n"
    )
    ((group, entries),) = tomllib.loads(project)["project"]["entry-points"].items()
    lines = [f"{name} = {value}\n" for name, value in entries.items()]
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{''.join(lines)}")
    (site / "fidpipe_pts.py").write_text(module)
    return site


def save_pts(stem, points):
    rows = np.column_stack([points.astype(np.float64), np.zeros(len(points))])
    np.savetxt(f"{stem}.pts", rows, fmt="%.17g", header=str(len(rows)), comments="")


def test_a_package_of_others_adds_a_format(tmp_path, pts_package):
    dataset = write(tmp_path / "streets", save_pts)
    assert "no scan pairs found" in command("check", dataset).stderr
    Extended(pts_package).fidpipe("check", dataset)


def test_our_reader_of_a_suffix_comes_before_that_of_others(monkeypatch):
    entries = [
        EntryPoint(name, f"other_package.{name}", "fidpipe.readers") for name in ("ply", "x")
    ]
    monkeypatch.setattr(formats, "entry_points", lambda group: entries)
    formats.known_formats.cache_clear()
    known = formats.known_formats()
    formats.known_formats.cache_clear()
    assert known[".ply"] is formats.FORMATS[".ply"]
    assert known[".x"].module == "other_package.x"
