"""The worked examples of docs/extending.md do what the page says."""

import re
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from fidpipe.pipeline.cli.main import app
from fidpipe.pipeline.datasets import readers
from fidpipe.pipeline.datasets.readers import Format, read_scan
from fidpipe.schemas.errors import ScanError
from scenes import drifted, street

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


def examples(section):
    """The Python of a section, block by block."""
    text = PAGE.split(f"\n## {section}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def xyz_reader(tmp_path, monkeypatch):
    """The documented reader in a file of the readers' package, and its row in the table."""
    reader, row = examples("A reader")
    folder = tmp_path / "readers"
    folder.mkdir()
    (folder / "xyz.py").write_text(reader)
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(folder)])
    monkeypatch.setattr(readers, "FORMATS", readers.FORMATS | eval(f"{{{row}}}", {"Format": Format}))
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


def test_check_reads_the_new_format(tmp_path, xyz_reader):
    shown = fidpipe("check", write(tmp_path / "streets", save_xyz))
    assert shown.exit_code == 0, shown.output


def test_check_does_not_know_the_format_without_its_row(tmp_path):
    with pytest.raises(Exception, match="no scan pairs found"):
        fidpipe("check", write(tmp_path / "streets", save_xyz))


def test_a_run_over_the_new_format_gives_the_numbers_of_a_known_one(tmp_path, xyz_reader):
    for name, save in (("xyz", save_xyz), ("npy", save_npy)):
        dataset = write(tmp_path / name, save)
        assert fidpipe("run", dataset, "--out", tmp_path / f"run-{name}", "--workers", 1).exit_code == 0
    for table in ("objects/a.real", "objects/a.sim", "metrics/a"):
        new, known = (pq.read_table(tmp_path / run / f"{table}.parquet") for run in ("run-xyz", "run-npy"))
        assert new.num_rows
        assert new.equals(known)


def test_check_names_what_is_wrong_with_a_file_of_the_new_format(tmp_path, xyz_reader):
    dataset = write(tmp_path / "streets", save_xyz)
    (dataset / "sim" / "a.xyz").write_text("1 2\n3 4\n")
    shown = fidpipe("check", dataset)
    assert shown.exit_code == 1
    with pytest.raises(ScanError, match=r"a\.xyz: 2 columns found, 3 wanted \(x y z\)"):
        read_scan(dataset / "sim" / "a.xyz")


@pytest.mark.parametrize("section", ["A reader", "A setting", "A baseline", "A score"])
def test_the_examples_of_the_page_are_python(section):
    blocks = examples(section)
    assert blocks
    for block in blocks:
        is_table_row = block.startswith('"') and not block.startswith('"""')
        compile(f"{{{block}}}" if is_table_row else block.rstrip().removesuffix(","), section, "exec")
