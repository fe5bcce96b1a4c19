"""The snippets of the pages, run on small data."""

import re
from pathlib import Path

import duckdb
import pandas as pd
import pytest

import fidpipe
from scenes import drifted, street, write_bin

DOCS = Path(__file__).resolve().parents[1] / "docs"


def blocks(page, language):
    """The code blocks of a page in one language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


def test_the_snippets_of_results_run(report_run, tmp_path, monkeypatch, capsys):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "streets").symlink_to(report_run)
    monkeypatch.chdir(tmp_path)
    write_bin(tmp_path / "streets" / "real" / "0000.bin", street())
    write_bin(tmp_path / "streets" / "sim" / "0000.bin", drifted(street()))
    names = {}
    first = fidpipe.open_run(report_run).scored[0]["pair_id"]
    for code in blocks("results.md", "python"):
        exec(code.replace('"0000"', ascii(first)), names)
    assert "r_lambda" in capsys.readouterr().out
    assert (tmp_path / "object.png").stat().st_size > 10_000 < (tmp_path / "pieces.png").stat().st_size
    assert names["result"].summary["status"] == "scored"
    (query,) = blocks("results.md", "sql")
    found = duckdb.sql(query).df().set_index("label")
    expected = names["both"].groupby("label").cdc.agg(["size", "mean"])
    pd.testing.assert_series_equal(
        found.objects, expected["size"], check_like=True, check_names=False, check_dtype=False
    )
    assert found.cdc.to_dict() == pytest.approx(expected["mean"].round(2).to_dict())
