"""The snippets of the pages, run on small data."""

import re
import shlex
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import pytest
from pypcd4 import PointCloud

import fidpipe
from fidpipe.pipeline.datasets.pairs import read_dataset
from runs import command
from scenes import drifted, street, write_bin, write_pair

DOCS = Path(__file__).resolve().parents[1] / "docs"


def blocks(page, languages):
    """Language and text of the code blocks of a page in some languages, separated by |."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^ *```({languages})\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE)


def test_the_snippets_of_results_run(report_run, tmp_path, monkeypatch, capsys):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "streets").symlink_to(report_run)
    monkeypatch.chdir(tmp_path)
    write_pair(tmp_path / "streets", street(), drifted(street()), "0000")
    names = {}
    first = fidpipe.open_run(report_run).scored[0]["pair_id"]
    for _, code in blocks("results.md", "python"):
        exec(code.replace('"0000"', ascii(first)), names)
    assert "r_lambda" in capsys.readouterr().out
    assert (
        (tmp_path / "object.png").stat().st_size
        > 10_000
        < (tmp_path / "pieces.png").stat().st_size
    )
    assert names["result"].summary["status"] == "scored"
    ((_, query),) = blocks("results.md", "sql")
    found = duckdb.sql(query).df().set_index("label")
    expected = names["matched"].groupby("label").cdc.agg(["size", "mean"])
    pd.testing.assert_series_equal(
        found.objects, expected["size"], check_like=True, check_names=False, check_dtype=False
    )
    assert found.cdc.to_dict() == pytest.approx(expected["mean"].round(2).to_dict())


def write_builds(folder, n):
    """Real scans in `drive`, and two builds of a simulator; the second one is 12 cm lower."""
    for i in range(n):
        real = street(seed=10 * i)
        sim = drifted(real, seed=i)
        write_bin(folder / "drive" / f"{20 * i}.000.bin", real)
        for build, up_m in (("build41", 0.0), ("build42", -0.12)):
            (folder / build).mkdir(exist_ok=True)
            moved = np.column_stack([sim + [0, 0, up_m], np.zeros(len(sim))]).astype(np.float32)
            PointCloud.from_xyzi_points(moved).save(folder / build / f"{20 * i}.000.pcd")


def test_a_script_of_twelve_lines_does_the_same_in_python(tmp_path, monkeypatch, capsys):
    write_builds(tmp_path, 2)
    monkeypatch.chdir(tmp_path)
    ((_, code),) = blocks("api.md", "python")
    assert len(code.splitlines()) <= 12
    names = {}
    exec(code, names)
    text = capsys.readouterr().out
    assert "worse 2 pairs of 2 places" in text
    assert names["comparison"].causes.words[0] == "world 11 cm too low"
    assert list(names["comparison"].table["name"])[:1] == [
        names["comparison"].families[0].scores[0].name
    ]
    assert names["diagnosed"].diagnosis.n_pairs == 2


def test_a_new_user_gets_from_two_folders_to_the_first_cause_in_three_commands(
    tmp_path, monkeypatch
):
    write_builds(tmp_path, 8)
    monkeypatch.chdir(tmp_path)
    output, n_commands = "", 0
    for language, text in blocks("decision.md", "sh|text"):
        if language == "sh":
            ended = command(*shlex.split(text)[1:], code=0)
            output = " ".join((ended.stdout + ended.stderr).split())
            n_commands += 1
        else:
            for line in text.splitlines():
                assert " ".join(line.split()) in output
    assert n_commands == 3
    assert {path.name for path in tmp_path.glob("*.html")} == {"compare.html", "build42.html"}
    assert not list(tmp_path.rglob("report.html"))
    times = read_dataset(tmp_path / "runs" / "datasets" / "build42").pairs
    assert {pair.pair_id: pair.timestamp_s for pair in times} == {
        f"{20 * i}.000": 20.0 * i for i in range(8)
    }
    assert "8 of 8 pairs can be evaluated" in command("check", "drive", "build42").stdout
    assert "0 jobs done" in command("run", "drive", "build42", "--preset", "reference").stdout


def test_the_snippets_of_how_do_i_run(report_run, tmp_path, monkeypatch):
    (tmp_path / "runs").mkdir()
    for build in ("build41", "build42"):
        (tmp_path / "runs" / build).symlink_to(report_run)
    monkeypatch.chdir(tmp_path)
    real = street()
    write_bin(tmp_path / "dataset" / "real" / "0007.bin", real)
    names = {}
    for _, code in blocks("how-do-i.md", "python"):
        exec(code, names)
    for written in ("0007.ply", "0007.pcd", "0007.parquet"):
        np.testing.assert_allclose(
            fidpipe.read_scan(tmp_path / written).points, real, atol=1e-5
        )
    pairs = pd.DataFrame(fidpipe.open_run(report_run).scored)
    assert names["table"].mean().to_dict() == pytest.approx(
        dict.fromkeys(["build41", "build42"], pairs.cdc_mean.mean())
    )
    assert (tmp_path / "cdc.png").stat().st_size > 0


@pytest.mark.exhaustive
def test_the_intervals_of_the_tutorial_are_as_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "tutorial.md").read_text("utf-8")
    assert "The intervals contain the truth: the 10 cm, and the third of the" in text
    command("synth", "streets", "--pairs", 8, "--points", 6000, code=0)
    (change,) = [
        code
        for _, code in blocks("tutorial.md", r"\{code-cell\} ipython3")
        if code.startswith("import shutil")
    ]
    exec(change, {})
    found = fidpipe.compare("streets", "streets-build2", workers=None).causes.set_index("name")
    bias = found.loc["range bias"]
    lost = found.loc["lost returns"]
    assert bias.low < 0.10 < bias.high
    assert lost.low < 1 / 3 < lost.high
