"""Runs in a row: the same scans in all of them, verdicts against the first and the one before, rejected histories."""

import csv
import io
import json
import shutil
from dataclasses import replace

import pandas as pd
import pytest

from fidpipe.pipeline.report.page.compare_page import history_page
from fidpipe.pipeline.report.render import csv_table
from fidpipe.pipeline.report.views.compare_view import history_decision, history_records, history_remarks, history_view
from fidpipe.pipeline.results import compare
from fidpipe.pipeline.results.compare import compare_two, read_history
from fidpipe.schemas.errors import RunError
from reports import embedded, text_of
from runs import command, copied, run
from scenes import drifted, street, write_pair

LONG = "n008-2018-08-01-15-16-36-0400__LIDAR_TOP__1533151603597909"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Three versions of a simulator, the second one much worse, the third the first again without its last pair."""
    folder = tmp_path_factory.mktemp("history")
    for version, noise, keep in (("a", 0.02, 0.95), (f"b-{LONG}", 0.3, 0.6)):
        for i in range(7):
            scan = street(seed=10 * i)
            write_pair(folder / f"data-{version}", scan, drifted(scan, seed=i, noise=noise, keep=keep), i)
        run(folder / f"data-{version}", folder / version)
    data, again = copied(folder / "data-a", folder / "a", folder / "c")
    (data / "sim" / "6.bin").write_bytes(b"")
    run(data, again)
    return [folder / "a", folder / f"b-{LONG}", again]


@pytest.fixture(scope="module")
def found(runs):
    return read_history(runs, independent=True)


def test_means_are_over_the_pairs_that_all_runs_have(found, runs):
    assert found.pairs == tuple("012345")
    assert list(found.left_out) == list(found.failed) == ["6"]
    assert [(one["n_scored"], one["n_failed"]) for one in found.runs] == [(7, 0), (7, 0), (6, 1)]
    for i, folder in enumerate(runs):
        pairs = pd.read_parquet(folder / "pairs.parquet").set_index("pair_id").loc[list(found.pairs)]
        means = {own.family: own.steps[i].mean for own in found.families}
        assert means["surface missing"] == pytest.approx(pairs["covered_real_0p3m"].mean())
        assert means["objects"] == pytest.approx(pairs["cdc_mean"].mean())


def test_verdicts_are_against_the_first_run_and_against_the_one_before(found):
    _, worse, back = next(own for own in found.families if own.family == "surface invented").steps
    assert (worse.since_first, worse.since_last) == ("worse", "worse")
    assert (back.since_first, back.since_last) == ("same", "better")
    assert worse.low <= worse.mean <= worse.high
    assert back.low == back.mean == back.high
    assert history_decision(found).startswith("run 3 against run 1: 1 pair that run 1 has scored fail now; ")
    assert any("of the 3 comparisons" in line.text for line in history_remarks(found))


def test_the_decided_score_is_shown_and_a_verdict_that_does_not_count_in_brackets(runs, monkeypatch):
    def compared(*args, **options):
        found = compare_two(*args, **options)
        families = []
        for own in found.families:
            verdicts = {"r_lambda": "worse"} if own.name == "objects" else {}
            scores = tuple(replace(score, verdict=verdicts.get(score.name, "undecided")) for score in own.scores)
            verdict, why = ("worse", "follows from rays") if verdicts else ("undecided", "")
            families.append(replace(own, verdict=verdict, why=why, scores=scores))
        return replace(found, families=tuple(families))

    monkeypatch.setattr(compare, "compare_two", compared)
    found = read_history(runs[:2], independent=True)
    own = next(own for own in found.families if own.family == "objects")
    assert (own.name, own.steps[1].since_first) == ("r_lambda", "(worse)")
    assert "(-) (-)" in text_of(history_view(found))
    assert "worse" not in history_decision(found)


def test_runs_stand_as_given_or_by_date(runs):
    order = [runs[2], runs[0], runs[1]]
    for i, folder in enumerate(runs):  # they may have been made within one second
        path = folder / "run.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"written": f"2026-01-0{i + 1}T00:00:00+00:00"}))
    as_given, by_date = read_history(order), read_history(order, by_date=True)
    assert [one["folder"] for one in as_given.runs] == [*map(str, order)]
    assert [one["folder"] for one in by_date.runs] == [*map(str, runs)]
    assert any("--by-date" in note for note in as_given.notes)
    assert not any("--by-date" in note for note in by_date.notes)


def test_eight_runs_with_long_names_fit_80_columns(runs):
    found = read_history([runs[0], *[runs[1]] * 6, runs[2]], independent=True)
    lines = text_of(history_view(found)).splitlines()
    assert max(map(len, lines)) <= 80
    assert sum("…" in line and line.endswith("1603597909") for line in map(str.rstrip, lines)) == 6, "one line a run"
    (covered,) = (line.split() for line in lines if line.strip().startswith("position"))
    assert len(covered) > 8


def test_csv_and_json_hold_every_step(found, runs):
    rows = list(csv.DictReader(io.StringIO(csv_table(history_records(found)))))
    assert len(rows) == 3 * len(found.families)
    assert float(rows[0]["mean"]) == found.families[0].steps[0].mean
    told = json.loads(json.dumps(found.as_dict()))
    assert told["runs"][1]["folder"] == str(runs[1])
    assert told["families"][0]["steps"][1]["mean"] == found.families[0].steps[1].mean


def test_the_page_has_a_line_for_each_score_with_its_intervals(found):
    charts = embedded(history_page(found))["charts"]
    assert len(charts) == len(found.families)
    line = charts["history_0"]["data"][0]
    step = found.families[0].steps[1]
    assert line["y"] == pytest.approx([own.mean for own in found.families[0].steps])
    assert line["error_y"]["array"][1] == pytest.approx(step.high - step.mean)


def test_the_command_takes_up_to_eight_runs(runs, tmp_path):
    result = command("compare", *runs, "--history", "--html", tmp_path / "page.html", "--markdown", code=0)
    assert result.stdout.startswith("**run 3 against run 1: ")
    assert (tmp_path / "page.html").exists()
    refused = command("compare", *[runs[0]] * 9, "--history", code=2)
    assert "9 runs given; expected 2 to 8" in refused.stderr


def test_runs_without_a_pair_that_all_have_are_refused(runs, tmp_path):
    data = shutil.copytree(runs[0].parent / "data-a", tmp_path / "data")
    for i in range(6):
        (data / "sim" / f"{i}.bin").write_bytes(b"")
    run(data, tmp_path / "run")
    with pytest.raises(RunError, match="no pair is scored by all"):
        read_history([runs[0], runs[2], tmp_path / "run"])
