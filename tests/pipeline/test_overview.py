"""The overview of a run against its tables, what a run ends with, and what it says of the run that it replaced."""

import json
import math
import os
import shutil
from io import StringIO

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from typer.testing import CliRunner

from fidpipe.pipeline.cli.main import app
from fidpipe.pipeline.report.results import read_results
from fidpipe.pipeline.report.terminal.layout import csv_table, markdown_table, plain_table, shortened
from fidpipe.pipeline.report.terminal.run import outcome_view
from fidpipe.pipeline.report.terminal.show import as_view, pair_view
from fidpipe.pipeline.report.verdict import verdict_of
from fidpipe.pipeline.results.findings import ObjectRows, SideRows
from fidpipe.pipeline.results.finished import FinishedRun, pair_facts
from fidpipe.pipeline.results.overview import Tally, run_overview, verdict_sentence
from fidpipe.pipeline.results.quadrants import quadrant_of
from fidpipe.schemas.settings import Settings
from runs import command, run
from scenes import drifted, street, write_bin

NUSCENES = [f"n008-2018-08-01-15-16-36-0400__LIDAR_TOP__15331516{i}7909" for i in (3597, 3647)]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("overview")
    for i, name in enumerate(NUSCENES):
        scan = street(i)
        for side, points in (("real", scan), ("sim", drifted(scan, noise=0.3, keep=0.4))):
            write_bin(folder / "streets" / side / f"{name}.bin", points)
            (np.arange(len(points)) * 7 // 100 % 3 + 1).astype("<u4").tofile(
                folder / "streets" / side / f"{name}.label"
            )
    long = "movable_object.pushable_pullable_and_more_words_than_fit"
    (folder / "streets" / "labels.toml").write_text(f'1 = "{long}.a"\n2 = "{long}.b"\n3 = "car"\n')
    return folder / "streets", folder / "run", run(folder / "streets", folder / "run")


def text_of(view, width=80):
    console = Console(file=StringIO(), width=width)
    console.print(view)
    return console.file.getvalue()


def invoked(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def side_of(rows):
    """Objects as (range_m, n_points, covered, is_matched, label)."""
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    range_m, n_points, covered, is_matched, label = columns
    ids = np.arange(len(rows), dtype=np.int32)
    shape = np.full(len(rows), "planar")
    size = np.full(len(rows), 10.0)
    return SideRows(
        0 * ids, ids, n_points, range_m, label.astype(object), shape, size, covered, is_matched.astype(bool)
    )


def counted(real, sim, matched):
    """The overview of one pair; matched objects as (real, sim, cdc, r_lambda, alignment)."""
    real_rows, sim_rows, cdc, r_lambda, alignment = (np.array(column) for column in zip(*matched, strict=True))
    scores = {"cdc": cdc, "r_lambda": r_lambda, "alignment_rms_m": alignment}
    real, sim = side_of(real), side_of(sim)
    scores["n_real"] = real.n_points[real_rows]
    tally = Tally()
    tally.add(ObjectRows(["a"], real, sim, 0 * real_rows, scores, real_rows, sim_rows))
    return tally.objects()


def test_the_verdict_counts_what_the_tables_hold(finished):
    _, folder, outcome = finished
    verdict = outcome.record.overview.verdict
    metrics, matching = pd.read_parquet(folder / "metrics"), pd.read_parquet(folder / "matching")
    quadrants = pd.Series(quadrant_of(metrics.cdc.to_numpy(), metrics.r_lambda.to_numpy(dtype=float))).value_counts()
    for name in ("faithful", "structure lost", "displaced", "failed"):
        assert getattr(verdict, name.replace(" ", "_")) == quadrants.get(name, 0)
    assert verdict.missing == (matching.status == "missing").sum()
    assert verdict.hallucinated == (matching.status == "hallucinated").sum()
    assert verdict.n_real == len(metrics) + verdict.missing
    assert f"Of the {verdict.n_real} real objects in 2 pairs" in verdict_sentence(verdict)


def test_numbers_are_the_means_over_pairs(finished):
    _, folder, outcome = finished
    pairs = pd.read_parquet(folder / "pairs.parquet")
    for number in outcome.record.overview.numbers:
        assert number.mean == pytest.approx(pairs[number.column].mean())
        assert number.std == pytest.approx(pairs[number.column].std())
        assert (number.n_pairs, number.last) == (2, None)
    assert [number.better for number in outcome.record.overview.numbers] == ["higher", *["lower"] * 3, "higher"]


def test_an_old_record_gets_the_same_overview_from_the_tables(finished, tmp_path):
    _, folder, outcome = finished
    old = shutil.copytree(folder, tmp_path / "old")
    record = json.loads((old / "run.json").read_text())
    del record["overview"]
    (old / "run.json").write_text(json.dumps(record))
    found = run_overview(FinishedRun(old))
    assert found.model_copy(update={"key": ""}) == outcome.record.overview.model_copy(update={"key": ""})


def test_the_overview_read_again_is_the_one_written_and_pairs_at_a_time_change_nothing(finished, monkeypatch):
    from fidpipe.pipeline.results import findings

    _, folder, outcome = finished
    monkeypatch.setattr(findings, "_FILES_AT_ONCE", 1)
    again = FinishedRun(folder)
    assert again.record.overview == outcome.record.overview
    one_by_one = Tally()
    findings.read_objects(again.store, NUSCENES, watch=one_by_one.add)
    assert one_by_one.objects().verdict == outcome.record.overview.verdict
    assert one_by_one.objects().worst == outcome.record.overview.worst
    assert one_by_one.objects().failings == outcome.record.overview.failings


def test_a_large_object_that_is_gone_is_worse_than_a_bad_one_and_that_than_a_handful_of_points():
    real = [(20.0, 1000, 0.0, False, "wall"), (9.0, 1000, 0.9, True, "car"), (9.0, 8, 0.0, False, "pole")]
    sim = [(9.0, 900, 0.9, True, "car")]
    worst = counted(real, sim, [(1, 0, 1.0, 0.5, 0.1)]).worst
    assert [one.object_id for one in worst] == [0, 1, 2]
    assert worst[0].what == "missing, absent: 0 % of it covered within 0.3 m"
    assert worst[1].what == "failed: CDC 1.00, r_lambda 0.50"
    assert math.log(1000) > (1.0 / 2 + 0.5) / 2 * math.log(1000) > math.log(8)


def test_faithful_objects_and_those_only_divided_differently_are_not_among_the_worst():
    real = [(5.0, 5000, 1.0, True, "wall"), (5.0, 5000, 0.9, False, "wall")]
    sim = [(5.0, 5000, 1.0, True, "wall"), (5.0, 5000, 0.81, False, "wall"), (5.0, 20, 0.5, False, "car")]
    found = counted(real, sim, [(0, 0, 0.5, 0.4, 0.1)])
    assert [(one.side, one.object_id) for one in found.worst] == [("sim", 2)]
    assert found.worst[0].what == "hallucinated, partly there: 50 % of it covered within 0.3 m"


def test_one_of_one_is_no_common_failing_and_a_share_counts_as_much_as_a_number():
    far = [(60.0, 50, 0.0, i >= 4, "wall") for i in range(6)]  # 4 of 6 missing: 16 / 6
    near = [(15.0, 50, 0.0, i >= 5, "tree") for i in range(25)]  # 5 of 25: 25 / 25
    there = [(25.0, 50, 0.95, False, "car") for _ in range(9)]
    alone = [(35.0, 50, 0.0, False, "pole"), (35.0, 50, 0.0, False, "pole")]
    real = [*far, *near, *there, *alone]
    matched = [i for i, one in enumerate(real) if one[3]]
    sim = [real[i] for i in matched]
    scores = [(i, j, 0.0, 0.0, 0.1) for j, i in enumerate(matched)]
    failings = counted(real, sim, scores).failings
    assert [failing.words for failing in failings] == [
        "wall beyond 50 m: missing 4 of 6",
        "tree at 10 to 20 m: missing 5 of 25",
    ]


def test_objects_without_any_label_are_told_by_their_shape():
    real = [(5.0, 500, 0.0, False, ""), (5.0, 500, 1.0, True, "")]
    found = counted(real, [real[1]], [(1, 0, 0.0, 0.0, 0.1)])
    assert (found.class_is, found.worst[0].label) == ("shape", "planar")


def test_an_alignment_is_bad_for_its_object_or_for_any():
    real = [(5.0, 500, 1.0, True, "car")] * 3
    matched = [(0, 0, 0.0, 0.0, 2.4), (1, 1, 0.0, 0.0, 2.6), (2, 2, 0.0, np.nan, 9.0)]
    found = counted(real, real, matched)
    assert (found.n_aligned, found.n_badly_aligned) == (2, 1), "of 10 m; without r_lambda it does not matter"
    assert found.verdict.unjudged == 1


def test_a_run_of_other_scans_says_what_it_replaced_and_one_with_nothing_to_do_still_does(finished, tmp_path):
    data = shutil.copytree(finished[0], tmp_path / "streets")
    folder = shutil.copytree(finished[1], tmp_path / "run")
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps({**record, "dataset": str(data)}))
    write_bin(data / "sim" / f"{NUSCENES[0]}.bin", drifted(street(0), noise=0.02, keep=0.9))
    (data / "sim" / f"{NUSCENES[0]}.label").unlink()
    after = run(data, folder).record
    assert after.previous.changes == ("1 pair of other scans",)
    assert after.previous.n_pairs == 2
    before = finished[2].record.summary
    for number in after.overview.numbers:
        assert number.last == before[number.column].mean
    assert after.overview.numbers[0].mean != after.overview.numbers[0].last
    again = run(data, folder).record
    assert (again.previous, again.overview) == (after.previous, after.overview)
    shown = text_of(as_view(FinishedRun(folder), None, None), 300)
    moved = after.overview.numbers[1].mean - after.overview.numbers[1].last
    assert f"{moved:+.3f}" in shown
    assert "1 pair of other scans" in shown
    assert "says nothing about chance" in shown
    assert "are of other objects than before: the match rate moved" in shown
    assert "are of other objects than before: the match rate moved" in " ".join(verdict_of(read_results(folder)).moved)
    other = run(data, folder, Settings.model_validate({"matching": {"delta_m": 3.0}})).record
    assert other.previous.changes == ("matching.delta_m was 5.0, is 3.0",)
    assert other.previous.means["cdc_mean"] == after.summary["cdc_mean"].mean
    covered = next(
        line for line in text_of(as_view(FinishedRun(folder), None, None)).splitlines() if "covered, 0" in line
    )
    assert "same" in covered, "no setting of the matching moves a surface"


def test_a_run_that_was_stopped_keeps_the_results_that_it_was_replacing(finished, tmp_path, monkeypatch):
    from fidpipe.pipeline import run as run_module

    data, folder = finished[0], shutil.copytree(finished[1], tmp_path / "run")

    def stop(*_):
        raise KeyboardInterrupt

    settings = Settings.model_validate({"matching": {"delta_m": 3.0}})
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(run_module._Run, "write", stop)
        run(data, folder, settings)
    assert "wall_s" not in json.loads((folder / "run.json").read_text())
    previous = run(data, folder, settings).record.previous
    assert previous.means["cdc_mean"] == finished[2].record.summary["cdc_mean"].mean
    assert previous.changes == ("matching.delta_m was 5.0, is 3.0",)


def test_a_run_ends_with_verdict_numbers_worst_failings_and_where_the_report_is(finished):
    _, folder, outcome = finished
    shown = text_of(outcome_view(outcome), 200)
    places = [
        shown.index(text)
        for text in (
            "jobs done",
            "Pairs (means over matched objects)",
            verdict_sentence(outcome.record.overview.verdict)[:60],
            "In five numbers",
            "The worst objects",
            "What limits the trust",
            "to look at them: fidpipe report",
        )
    ]
    assert places == sorted(places)
    assert shown.rstrip().splitlines()[-1] == f"to look at them: fidpipe report {folder}"
    assert "claim" not in shown, "the paper's claims are asked for by --paper"
    assert "2 independent pairs: too few" in shown


def test_a_report_of_these_results_is_named_and_an_older_one_is_not_taken_for_it(finished, tmp_path):
    folder = shutil.copytree(finished[1], tmp_path / "run")
    run_ = FinishedRun(folder)
    (folder / "report.html").write_text("<html>")
    assert text_of(as_view(run_, None, None), 300).rstrip().endswith(f"report: {folder / 'report.html'}")
    later = (folder / "report.html").stat().st_mtime + 10
    os.utime(folder / "pairs.parquet", (later, later))
    assert "the report there is older" in text_of(as_view(run_, None, None), 300)


@pytest.mark.parametrize("name", [None, NUSCENES[0]])
def test_no_line_is_wider_than_80_columns_with_long_names_and_labels(finished, name):
    run_ = FinishedRun(finished[1])
    for with_all in (False, True):
        shown = text_of(as_view(run_, name, None, with_all=with_all))
        assert max(map(len, shown.splitlines())) <= 80
        rows = [line.split()[0] for line in shown.splitlines() if "…" in line]
        assert rows, "some name was shortened"
    if name is None:
        first = [line.split()[0] for line in shown.splitlines() if line.startswith(" n008")]
        assert len(set(first)) == 2, "shortened names can be told apart"
        assert all(line.rstrip()[-1].isdigit() for line in shown.splitlines() if line.startswith(" n008")), "in a line"


def test_short_names_stay_as_they_are_and_shortened_ones_differ():
    assert shortened(["000", "001"], 8) == {"000": "000", "001": "001"}
    names = [f"{'x' * 30}{i}{'y' * 30}" for i in range(3)]
    short = shortened(names, 8)
    assert len(set(short.values())) == 3
    assert all(len(own) < 61 for own in short.values())
    wide = text_of(plain_table("t", ["pair", "n"], [[NUSCENES[0], 1]]), 120)
    assert NUSCENES[0] in wide


def test_markdown_and_csv_hold_what_a_name_may_hold():
    rows = [["a|b\nc", None, 0.5], ['=1,"', 2, None]]
    assert markdown_table(["pair", "n", "CDC"], rows).splitlines()[2:] == [
        "| a\\|b\\u000ac |  | 0.500 |",
        '| =1," | 2 |  |',
    ]
    assert csv_table(["pair", "n", "CDC"], rows) == 'pair,n,CDC\na|b\\u000ac,,0.5\n"\'=1,""",2,\n'


def test_a_pair_warns_where_r_lambda_stands_on_a_bad_alignment(finished):
    facts = pair_facts(FinishedRun(finished[1]), NUSCENES[0])
    scored = [each for each in facts.objects if each.scores and each.scores["r_lambda"] is not None]
    for each in scored:
        each.scores["alignment_rms_m"] = 0.01
    assert "bad alignment" not in text_of(pair_view(facts), 300)
    scored[0].scores["alignment_rms_m"] = 20.0
    shown = text_of(pair_view(facts), 300)
    assert f"r_lambda of 1 of {len(scored)} objects stands on a bad alignment" in shown
    assert f"real:{scored[0].real['community_id']} (20.0 m apart" in shown


@pytest.fixture(scope="module")
def by_command(finished, tmp_path_factory):
    out = tmp_path_factory.mktemp("json") / "run"
    return command("run", finished[0], "--out", out, "--workers", 1, "--json"), out


def test_run_as_json_is_json_alone_and_what_show_gives(by_command):
    done, out = by_command
    found = json.loads(done.stdout)
    assert done.returncode == 0
    assert found["jobs"]["made"] > 0
    assert found["failures"] == {}
    shown = json.loads(invoked("show", out, "--json").stdout)
    assert {name: found[name] for name in shown} == shown
    assert found["record"]["overview"]["verdict"]["n_pairs"] == 2


def test_check_as_json_names_each_scan_and_fault(finished, tmp_path):
    data = shutil.copytree(finished[0], tmp_path / "streets")
    (data / "sim" / f"{NUSCENES[1]}.bin").write_bytes(b"")
    done = invoked("check", data, "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 1
    assert [pair["pair_id"] for pair in found["pairs"]] == NUSCENES
    assert found["pairs"][0]["real"]["n_clean"] > 0
    assert "empty" in found["pairs"][1]["sim"]["fault"]
    assert any("empty" in fault for fault in found["faults"])
    assert found["sensors"]["pair_ids"] == NUSCENES
    assert set(found["sensors"]["sides"]) == {"real", "sim"}


def test_show_gives_csv_that_pandas_reads_and_markdown_tables(by_command):
    _, out = by_command
    pairs = pd.read_csv(StringIO(invoked("show", out, "--csv").stdout))
    assert pairs.cdc_mean.tolist() == pd.read_parquet(out / "pairs.parquet").cdc_mean.tolist()
    objects = pd.read_csv(StringIO(invoked("show", out, NUSCENES[0], "--csv").stdout))
    metrics = pd.read_parquet(out / "metrics").query("pair_id == @NUSCENES[0]").set_index("real_id")
    matched = objects[objects.status == "matched"].set_index("real_id")
    assert matched.cdc.to_dict() == metrics.cdc.to_dict()
    one = pd.read_csv(StringIO(invoked("show", out, NUSCENES[0], 0, "--csv").stdout), index_col=0)
    assert float(one.score["cdc"]) == metrics.cdc[0]
    markdown = invoked("show", out, "--markdown").stdout
    assert markdown.startswith("Of the ")
    assert "| match rate |" in markdown
    assert NUSCENES[0] in invoked("show", out, NUSCENES[0], "--markdown").stdout


@pytest.mark.parametrize("words", [("--csv", "--json"), ("--markdown", "--csv"), ("--markdown", "--paper")])
def test_formats_exclude_each_other(by_command, words):
    done = invoked("show", by_command[1], *words)
    assert done.exit_code == 2
    assert done.stdout == ""


def test_status_answers_in_ten_lines_and_times_only_when_asked(by_command):
    shown = invoked("status", by_command[1]).stdout
    assert len(shown.splitlines()) <= 10
    assert "done of all pairs: ground, graph" in shown
    assert "Time of a pair" not in shown
    assert "Time of a pair" in invoked("status", by_command[1], "--timings").stdout
