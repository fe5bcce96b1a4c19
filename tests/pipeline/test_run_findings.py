"""Findings of a run over all its pairs, against its tables."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline import run as run_module
from fidpipe.pipeline.paper.claims_view import claims_of
from fidpipe.pipeline.report.views.run_view import summary_view
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from reports import text_of
from runs import command, run
from scenes import street, write_bin, write_dataset


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("findings")
    data = write_dataset(folder / "streets", 3)
    names = ["000", "001", "002"]
    rows = [f"{name},real/{name}.bin,sim/{name}.bin,{100 * i}" for i, name in enumerate(names)]
    (data / "pairs.csv").write_text("pair_id,real,sim,timestamp_s\n" + "\n".join(rows) + "\n")
    for side in ("real", "sim"):
        for name in names:
            n = (data / side / f"{name}.bin").stat().st_size // 16
            (np.arange(n) % 2 + 1).astype("<u4").tofile(data / side / f"{name}.label")
    (data / "labels.toml").write_text('1 = "<b>odd</b>"\n2 = "even"\n')
    return data, folder / "run", run(data, folder / "run")


def recorded(folder):
    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads((folder / "run.json").read_text(), parse_constant=refuse)


def test_the_findings_agree_with_the_tables(finished):
    _, folder, _ = finished
    found = recorded(folder)["findings"]
    metrics = pd.read_parquet(folder / "metrics")
    objects = pd.read_parquet(folder / "objects")
    matching = pd.read_parquet(folder / "matching")
    assert found["n_matched"] == len(metrics)
    assert found["distributions"]["r_lambda"]["median"] == pytest.approx(metrics.r_lambda.median())
    assert found["distributions"]["cdc"]["q95"] == pytest.approx(metrics.cdc.quantile(0.95))
    assert found["density_ratio"]["max"] == pytest.approx((metrics.n_sim / metrics.n_real).max())
    assert found["rank_correlation"]["spearman"] == pytest.approx(metrics.cdc.corr(metrics.r_lambda, method="spearman"))
    for side, what in (("real", "missing"), ("sim", "hallucinated")):
        assert sum(band[f"n_{side}"] for band in found["range_m"]["bands"]) == (objects.side == side).sum()
        assert sum(band[f"n_{what}"] for band in found["range_m"]["bands"]) == (matching.status == what).sum()
        assert sum(row[f"n_{side}"] for row in found["classes"]) == (objects.side == side).sum()
    assert [scan["pair"] for scan in found["scans"]["scans"]] == ["000", "001", "002"]
    assert found["scans"]["apart"] is True


def test_a_run_with_nothing_new_reads_no_table_again(finished, monkeypatch):
    data, folder, outcome = finished
    monkeypatch.setattr(run_module, "describe_objects", lambda *_, **__: pytest.fail("the tables were read"))
    assert run(data, folder).record.as_dict()["findings"] == outcome.record.as_dict()["findings"]


def test_other_timestamps_make_other_findings(finished):
    data, folder, before = finished
    manifest = (data / "pairs.csv").read_text()
    try:
        (data / "pairs.csv").write_text(manifest.replace(",200", ",130"))
        after = run(data, folder)
        assert after.n_made == 0
        assert [scan["pair"] for scan in after.record.as_dict()["findings"]["scans"]["scans"]] == ["000", "001"]
    finally:
        (data / "pairs.csv").write_text(manifest)
    assert run(data, folder).record.as_dict()["findings"] == before.record.as_dict()["findings"]


def test_a_run_without_a_scored_pair_has_no_findings(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    (data / "sim" / "000.bin").write_bytes(b"")
    record = run(data, tmp_path / "run").record.as_dict()
    assert record["findings"] == {}
    assert record["pairs"] == {"scored": 0, "failed": 1, "to_do": 0}


def test_seconds_are_kept_by_stage_and_pair_and_status_shows_them(finished):
    _, folder, _ = finished
    seconds = recorded(folder)["seconds"]
    timings = pd.read_parquet(folder / "timings.parquet")
    assert set(seconds["pairs"]) == {"000", "001", "002"}
    total = timings.groupby(["pair_id", "stage"]).seconds.sum()
    assert seconds["pairs"]["001"]["metrics"] == pytest.approx(total["001", "metrics"], abs=1e-6)
    louvain = timings[timings.step == "louvain"].seconds.sum() / 3
    assert seconds["mean"]["communities"]["louvain"] == pytest.approx(louvain)
    assert run_status(folder).mean_seconds == seconds["mean"]
    shown = command("status", folder, "--timings").stdout
    for figure in ("544", "596", "1505", "1532", "7120"):
        assert figure in shown


def test_a_run_shows_findings_and_the_claims(finished):
    data, folder, _ = finished
    result = command("run", data, "--out", folder, "--workers", 1)
    assert result.returncode == 0
    shown = command("show", folder, "--all").stdout
    assert "Rank correlation of CDC and r_lambda" in shown
    assert "<b>odd</b>" in shown
    claims = command("show", folder, "--paper")
    assert claims.returncode == 0
    assert "0.37 ± 0.03" in claims.stdout
    assert "expected at least 6 pairs, got 3" in claims.stdout
    for claim in json.loads(command("show", folder, "--paper", "--json").stdout):
        if "above 0" in claim["rule"]:
            assert claim["verdict"] == "not decided"
            assert claim["n_pairs"] <= 3


def test_copies_of_a_pair_count_once_in_the_claims(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    once = run(data, tmp_path / "once")
    for side in ("real", "sim"):
        for name in ("copy", "another"):
            shutil.copy(data / side / "000.bin", data / side / f"{name}.bin")
    copied = run(data, tmp_path / "copied")
    assert copied.record.findings.n_independent == once.record.findings.n_independent == 1
    claims = [claims_of(FinishedRun(tmp_path / name)) for name in ("once", "copied")]
    assert claims[0] == claims[1]
    assert "3 pairs count as 1" in command("show", tmp_path / "copied", "--paper").stdout


def test_a_pair_without_a_match_is_counted_beside_the_means_and_is_the_worst(tmp_path):
    data = write_dataset(tmp_path / "streets", 2)
    write_bin(data / "sim" / "001.bin", street() + [60, 0, 0])
    outcome = run(data, tmp_path / "run")
    first = next(row for row in outcome.rows if row["pair_id"] == "000")
    n_unmatched = first["n_missing"] + first["n_hallucinated"]
    worst = (first["cdc_mean"] * first["n_matched"] + 2 * n_unmatched) / (first["n_matched"] + n_unmatched)
    summary, n_scored = outcome.record.summary, outcome.record.pairs.scored
    assert (summary["cdc_mean"].n_pairs, summary["match_rate"].n_pairs) == (n_scored - 1, n_scored)
    assert summary["cdc_unmatched_worst_mean"].n_pairs == n_scored
    view = summary_view(outcome.folder, [first], outcome.record, outcome.record.overview, with_all=True)
    (line,) = (line for line in text_of(view, 300).splitlines() if "geometry: 0 for the same " in line)
    assert f"{n_scored - 1} of {n_scored} " in line
    assert f"{summary['cdc_unmatched_worst_mean'].mean:.3f}" in line
    alone = run(data, tmp_path / "alone", pattern="000").record.summary["cdc_unmatched_worst_mean"].mean
    assert alone == pytest.approx(worst)
