"""The worked examples of docs/extending.md do what the page says, in the files that it names and no others."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fidpipe.pipeline.cli.main import app
from fidpipe.pipeline.datasets import readers
from fidpipe.pipeline.datasets.readers import Format, read_scan
from fidpipe.schemas.errors import DatasetError, ScanError
from runs import JOBS_PER_PAIR, own_process
from scenes import drifted, street, write_bin

N_POINTS = 100

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
FILE = re.compile(r"`([\w/]+\.(?:py|csv))`")
MOST_FILES = {"A reader": 2, "A setting": 2, "A baseline metric": 4, "A score": 4, "A stage": 5}


class Block(NamedTuple):
    """One example: its file, the one that was named last before it, and its code."""

    path: str
    code: str


def section_of(title):
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def blocks_of(title):
    """The Python and CSV of a section, block by block."""
    texts = re.split(r"```(?:python|csv)\n(.*?)```", section_of(title), flags=re.DOTALL)
    return [Block(FILE.findall("".join(texts[:i:2]))[-1], texts[i]) for i in range(1, len(texts), 2)]


def files_of(title):
    """The files that the numbered list of a section names, one for each line of it."""
    items = re.findall(r"^\d+\. (.*?)(?=^\d+\. |^$)", section_of(title), re.DOTALL | re.MULTILINE)
    return [named[0] for item in items if (named := FILE.findall(item))]


# Places of a block in an existing file. Each function takes the file's text and the block.


def last_in(name):
    """At the end of the value of this name, or of what the function of this name returns.

    A block that repeats a call has `...` for the arguments that are there.
    """

    def edit(text, code):
        node = statement(text, name)
        value = node.body[-1].value if isinstance(node, ast.FunctionDef) else node.value
        if isinstance(value, ast.DictComp):
            value = value.generators[0].iter
        if isinstance(node, ast.FunctionDef) and isinstance(value, ast.Call):
            code = ", ".join(ast.unparse(argument) for argument in ast.parse(code).body[0].value.keywords)
        end = offset(text, value.end_lineno, value.end_col_offset) - 1
        head = text[:end].rstrip()
        return f"{head}{'' if head.endswith(',') else ','}\n{code.rstrip().removesuffix(',')},\n{text[end:]}"

    return edit


def at_the_end(text, code):
    return text + code


def last_of_group(text, code):
    """Behind the last row of its group."""
    group = code.partition(",")[0]
    last = max(i for i, line in enumerate(text.splitlines(), 1) if line.startswith(f"{group},"))
    return insert(text, last + 1, code)


def field_in(name):
    """After the last field of the class of this name."""

    def edit(text, code):
        last = [node for node in statement(text, name).body if isinstance(node, ast.AnnAssign)][-1]
        return insert(text, last.end_lineno + 1, code, indent=4)

    return edit


def before(name):
    """Before what has this name."""
    return lambda text, code: insert(text, statement(text, name).lineno, f"{code}\n\n")


def before_return_of(name):
    """Before the function of this name returns."""
    return lambda text, code: insert(text, statement(text, name).body[-1].lineno, code, indent=4)


def after_imports(text, code):
    """Behind the last import."""
    last = [node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom)][-1]
    return insert(text, last.end_lineno + 1, code)


def raised_version(text):
    """The file with the version of its stage raised by one."""
    raised, n = re.subn(r"\bversion=(\d+),", lambda old: f"version={int(old[1]) + 1},", text)
    assert n == 1
    return raised


def statement(text, name):
    (node,) = [node for node in ast.parse(text).body if name in likeness(node)]
    return node


def likeness(node):
    """The names that a statement binds; else the statement itself."""
    match node:
        case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
            return (name,)
        case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
            return (name,)
    return (node,)


def offset(text, line, column):
    return sum(map(len, text.splitlines(keepends=True)[: line - 1])) + column


def insert(text, line, code, indent=0):
    at = offset(text, line, 0)
    return text[:at] + re.sub(r"^(?=.)", " " * indent, code, flags=re.MULTILINE) + text[at:]


#: Of each section, where its blocks go; None is a new file.
PLACES = {
    "A reader": [None, last_in("FORMATS")],
    "A setting": [field_in("GraphSettings"), before_return_of("build_graph")],
    "A baseline metric": [last_of_group, None, after_imports, last_in("BASELINES")],
    "A score": [
        last_of_group,
        field_in("Scores"),
        last_in("score_object"),
        last_in("SPECTRAL"),
        last_in("spectral"),
    ],
    "A stage": [
        at_the_end,
        before("Settings"),
        field_in("Settings"),
        None,
        None,
        after_imports,
        last_in("STAGES"),
    ],
}


class Extended(NamedTuple):
    """A copy of the package with the examples of a section written into it."""

    folder: Path

    def fidpipe(self, *words, exit_code=0):
        """The command of the copy."""
        result = self.python("from fidpipe.pipeline.cli.main import main; main()", *words)
        assert result.returncode == exit_code, result.stdout + result.stderr
        return result

    def python(self, code, *words):
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        call = [sys.executable, "-c", code, *map(str, words)]
        return subprocess.run(call, capture_output=True, text=True, check=False, env=environment, cwd=self.folder)

    def breaks_no_layer(self):
        """True if imports go downwards only, else the linter's output."""
        shutil.copy(ROOT / "pyproject.toml", self.folder)
        lint = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        result = subprocess.run(lint, capture_output=True, text=True, check=False, env=environment, cwd=self.folder)
        return result.returncode == 0 or result.stdout

    def run_examples(self, module):
        """Runs the examples in the docstrings of a module; gives how many there are."""
        code = (
            f"import doctest, {module} as module; result = doctest.testmod(module); "
            "assert not result.failed; print(result.attempted, module.__file__)"
        )
        n, path = self.python(code).stdout.split()
        assert path.startswith(str(self.folder))
        return int(n)


def extended(title, folder):
    """A copy of the package with the blocks of a section in their places; gives it with the files that were touched."""
    package = folder / "fidpipe"
    for part in ("pipeline", "schemas", "stages"):
        shutil.copytree(ROOT / part, package / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "__init__.py", package)
    touched = []
    for block, edit in zip(blocks_of(title), PLACES[title], strict=True):
        path = package / block.path
        assert path.exists() == (edit is not None), block.path
        path.write_text(block.code if edit is None else edit(path.read_text(), block.code))
        touched.append(block.path)
    if title == "A score":
        path = package / files_of(title)[-1]
        path.write_text(raised_version(path.read_text()))
        touched.append(files_of(title)[-1])
    for path in (path for path in touched if path.endswith(".py")):
        compile((package / path).read_text(), path, "exec")
    return Extended(folder), touched


@pytest.mark.parametrize("title", PLACES)
def test_an_example_touches_the_files_that_its_section_names_and_they_are_few(title, tmp_path):
    _, touched = extended(title, tmp_path)
    files = files_of(title)
    assert sorted(set(touched)) == sorted(files)
    assert len(files) <= MOST_FILES[title]
    anchor = title.lower().replace(" ", "-")
    (row,) = [line for line in PAGE.splitlines() if line.startswith("|") and f"(#{anchor})" in line]
    assert int(re.search(r"\| (\d)", row)[1]) == len(files)


def made_again(result):
    """The stages that the command says it replaces."""
    lines = [line for line in result.stderr.splitlines() if line.startswith("replacing ")]
    return {name for line in lines for name in re.search(r"replacing (.*?) of ", line)[1].split(", ")}


def test_the_setting_is_obeyed_checked_recorded_and_part_of_the_key(again, dataset, tmp_path):
    package, _ = extended("A setting", tmp_path)
    run = ("run", dataset, "--out", again, "--workers", 1)
    assert made_again(package.fidpipe(*run)) == {
        "graph",
        "communities",
        "matching",
        "coverage",
        "surface",
        "selection",
        "metrics",
    }
    assert made_again(package.fidpipe(*run)) == set()
    result = package.fidpipe(*run, "--set", "graph.max_edge_m=0.5", "--replace")
    assert made_again(result) == {"graph", "communities", "matching", "coverage", "surface", "selection", "metrics"}
    assert "graph.max_edge_m was None, is 0.5" in result.stderr
    assert pd.read_parquet(again / "graph").length_m.max() <= 0.5
    assert "max_edge_m = 0.5" in (again / "settings.toml").read_text()
    wrong = package.fidpipe(*run, "--set", "graph.max_edge_m=0", exit_code=1)
    assert wrong.stderr.startswith("error: setting graph.max_edge_m: expected a number above 0, got 0")


@pytest.mark.exhaustive
def test_the_baseline_is_computed_swept_and_timed(again, dataset, tmp_path):
    package, _ = extended("A baseline metric", tmp_path)
    assert package.breaks_no_layer() is True
    package.fidpipe("run", dataset, "--out", again, "--workers", 1, "--set", "metrics.baselines=box_overlap")
    rows, metrics = pd.read_parquet(again / "baselines"), pd.read_parquet(again / "metrics")
    assert rows.real_id.notna().sum() == len(metrics)
    ground = pd.read_parquet(again / "ground").query("not is_ground and pair_id == '000'")
    low, high = (getattr(ground.groupby("side")[["x", "y", "z"]], end)() for end in ("min", "max"))
    common = (high.min() - low.max()).clip(lower=0).prod()
    whole = rows[rows.real_id.isna() & (rows.pair_id == "000")].value.item()
    assert whole == pytest.approx(common / ((high - low).prod(axis=1).sum() - common))
    timings = pd.read_parquet(again / "timings.parquet").query("stage == 'baselines'")
    assert {"box_overlap", "box_overlap, whole scan"} <= set(timings.step)
    words = ("--sweep", "dropout=0.4", "--repeats", 1, "--global-repeats", 0, "--workers", 1)
    package.fidpipe("perturb", dataset, "--out", tmp_path / "perturb", "--metrics", "box_overlap", *words)
    assert pd.read_parquet(tmp_path / "perturb" / "perturb_baselines").value.between(0, 1).all()


@pytest.mark.exhaustive
def test_the_score_is_in_every_table_and_nothing_stale_is_kept(again, dataset, tmp_path):
    package, _ = extended("A score", tmp_path)
    words = ("--sweep", "noise=0.01", "--repeats", 1, "--global-repeats", 1, "--workers", 1)
    perturb = ("perturb", dataset, "--out", tmp_path / "perturb", *words)
    assert own_process(*perturb).returncode == 0
    result = package.fidpipe("run", dataset, "--out", again, "--workers", 1, "--replace")
    assert made_again(result) == {"metrics"}
    assert "code of stage metrics is new" in result.stderr
    metrics = pd.read_parquet(again / "metrics").dropna(subset="laplacian_change")
    assert (metrics.frobenius_change >= metrics.laplacian_change - 1e-9).all()
    verified = json.loads(package.fidpipe("verify", again, "--all", "--json").stdout)
    columns = {own["table"]: own["columns"] for own in verified["tables"]}
    assert "frobenius_change" in columns["metrics"]
    assert "frobenius_change_mean" in columns["pairs"]
    assert verified["unknown"] == []
    pairs = pd.read_parquet(again / "pairs.parquet").set_index("pair_id")
    means = pd.read_parquet(again / "metrics").groupby("pair_id").frobenius_change.mean()
    assert pairs.frobenius_change_mean.to_dict() == pytest.approx(means.to_dict())
    assert made_again(package.fidpipe(*perturb, "--replace")) == {"perturb_global", "perturb_objects"}
    assert "frobenius_change_mean" in pd.read_parquet(tmp_path / "perturb" / "perturb_global")
    scan = dataset / "real" / "000.bin"
    for side in ("real", "sim"):
        write_bin(tmp_path / "same" / side / "a.bin", np.fromfile(scan, "<f4").reshape(-1, 4)[:, :3])
    package.fidpipe("run", tmp_path / "same", "--out", tmp_path / "identical", "--workers", 1)
    assert (pd.read_parquet(tmp_path / "identical" / "metrics").frobenius_change.dropna() == 0).all()


@pytest.mark.exhaustive
def test_the_stage_is_made_shown_and_made_again_alone(again, dataset, tmp_path):
    package, _ = extended("A stage", tmp_path)
    assert package.breaks_no_layer() is True
    assert package.run_examples("fidpipe.stages.neighbours") == 1
    run = ("run", dataset, "--out", again)
    result = package.fidpipe(*run, "--workers", 1)
    assert made_again(result) == set()
    assert f"4 jobs done, {2 * JOBS_PER_PAIR} reused" in result.stdout
    objects, rows = (pd.read_parquet(again / table) for table in ("objects", "neighbours"))
    assert len(rows) == len(objects)
    for (pair_id, side), own in objects.groupby(["pair_id", "side"]):
        centroids = own.sort_values("community_id")[["cx", "cy", "cz"]].to_numpy()
        apart = np.linalg.norm(centroids[:, None] - centroids[None], axis=2) + np.diag(np.full(len(own), np.inf))
        nearest = rows[(rows.pair_id == pair_id) & (rows.side == side)].sort_values("community_id").nearest_m
        np.testing.assert_allclose(nearest, np.where(apart.min(axis=1) <= 20, apart.min(axis=1), np.nan))
    assert "nearest" in set(pd.read_parquet(again / "timings.parquet").query("stage == 'neighbours'").step)
    assert re.search(r"done of all pairs: .*neighbours", package.fidpipe("status", again).stdout)
    verified = json.loads(package.fidpipe("verify", again, "--json").stdout)
    assert verified["unknown"] == ["neighbours.community_id", "neighbours.nearest_m"], (
        "nobody has told the literal twin"
    )
    assert made_again(package.fidpipe(*run, "--workers", 1, "--set", "neighbours.within_m=5", "--replace")) == {
        "neighbours"
    }
    package.fidpipe("run", dataset, "--out", tmp_path / "two", "--workers", 2)
    package.fidpipe(*run, "--workers", 1, "--replace")
    for path in (tmp_path / "two" / "neighbours").iterdir():
        assert pq.read_table(path).equals(pq.read_table(again / "neighbours" / path.name))


@pytest.fixture
def xyz_reader(tmp_path, monkeypatch):
    """The documented reader in a file of the readers' package, and its row in the table."""
    reader, row = blocks_of("A reader")
    folder = tmp_path / "readers"
    folder.mkdir()
    (folder / "xyz.py").write_text(reader.code)
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(folder)])
    monkeypatch.setattr(readers, "FORMATS", readers.FORMATS | eval(f"{{{row.code}}}", {"Format": Format}))
    yield
    sys.modules.pop(f"{readers.__name__}.xyz", None)


def write(folder, save):
    """One small pair, as a writer of some format saves it."""
    scan = street()
    for side, points in (("real", scan), ("sim", drifted(scan))):
        (folder / side).mkdir(parents=True)
        save(folder / side / "a", points.astype(np.float32))
    return folder


def save_xyz(stem, points):
    np.savetxt(f"{stem}.xyz", points.astype(np.float64), fmt="%.17g")


def save_npy(stem, points):
    np.save(f"{stem}.npy", points)


def fidpipe(*words):
    return CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)


def test_a_run_over_the_new_format_gives_the_numbers_of_a_known_one(tmp_path, xyz_reader):
    for name, save in (("xyz", save_xyz), ("npy", save_npy)):
        dataset = write(tmp_path / name, save)
        assert fidpipe("run", dataset, "--out", tmp_path / f"run-{name}", "--workers", 1).exit_code == 0
    for table in ("objects/a.real", "objects/a.sim", "metrics/a"):
        new, known = (pq.read_table(tmp_path / run / f"{table}.parquet") for run in ("run-xyz", "run-npy"))
        assert new.num_rows
        assert new.equals(known)


@pytest.fixture
def pts_package(tmp_path):
    """The documented package, as pip lays it out: its module, and metadata from its pyproject.toml."""
    section, site = section_of("A reader in another package"), tmp_path / "site"
    (project,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    (module,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    metadata = site / "fidpipe_pts-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fidpipe-pts\nVersion: 1.0\n")
    ((group, entries),) = tomllib.loads(project)["project"]["entry-points"].items()
    lines = [f"{name} = {value}\n" for name, value in entries.items()]
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{''.join(lines)}")
    (site / "fidpipe_pts.py").write_text(module)
    return site


def save_pts(stem, points):
    rows = np.column_stack([points.astype(np.float64), np.zeros(len(points))])
    np.savetxt(f"{stem}.pts", rows, fmt="%.17g", header=str(len(rows)), comments="")


def test_a_package_of_others_adds_a_format_that_check_and_run_read(tmp_path, pts_package):
    dataset = write(tmp_path / "streets", save_pts)
    environment = os.environ | {"PYTHONPATH": str(pts_package)}
    code = "from fidpipe.pipeline.cli.main import main; main()"
    call = [sys.executable, "-c", code, "check", str(dataset)]
    shown = subprocess.run(call, capture_output=True, text=True, check=False, env=environment)
    assert shown.returncode == 0, shown.stdout + shown.stderr
    without = subprocess.run(call, capture_output=True, text=True, check=False)
    assert without.returncode == 1
    assert "no scan pairs found" in without.stderr


def test_two_readers_of_one_suffix_are_refused_and_both_named(monkeypatch):
    entries = [EntryPoint("ply", "other_package.ply", "fidpipe.readers")]
    monkeypatch.setattr(readers, "entry_points", lambda group: entries)
    readers._other_formats.cache_clear()
    with pytest.raises(DatasetError, match=r"two readers of \.ply files are installed, ply and other_package\.ply"):
        readers.formats()
    readers._other_formats.cache_clear()


def test_check_reads_the_new_format_and_names_what_is_wrong_with_a_file(tmp_path, request):
    dataset = write(tmp_path / "streets", save_xyz)
    with pytest.raises(DatasetError, match="no scan pairs found"):
        fidpipe("check", dataset)
    request.getfixturevalue("xyz_reader")
    shown = fidpipe("check", dataset)
    assert shown.exit_code == 0, shown.output
    (dataset / "sim" / "a.xyz").write_text("1 2\n3 4\n")
    shown = fidpipe("check", dataset)
    assert shown.exit_code == 1
    with pytest.raises(ScanError, match=r"a\.xyz: expected 3 columns \(x y z\), got 2"):
        read_scan(dataset / "sim" / "a.xyz")
