"""A finished run read again: the same numbers as its tables, for people and for programs."""

import json

import pandas as pd
import pytest

from fidpipe.pipeline.report.figures.plots import plot_object
from fidpipe.pipeline.report.view import Table
from fidpipe.pipeline.report.views.show_view import object_view, pair_view
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.storage.run_record import read_run
from fidpipe.schemas.errors import RunError
from reports import HOSTILE_PAIRS, text_of
from runs import command

FIRST = HOSTILE_PAIRS[0]
BROKEN = "broken <b>pair</b>"


def shown(*words):
    result = command("show", *words)
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


@pytest.mark.parametrize("name", HOSTILE_PAIRS)
def test_json_holds_the_numbers_of_the_tables_whatever_the_pair_is_called(report_run, name):
    metrics = (
        pd.read_parquet(report_run / "metrics").query("pair_id == @name").set_index("real_id")
    )
    found = json.loads(shown(report_run, name, "--json"))
    assert found["pair"]["pair_id"] == name
    of_both = [of for of in found["objects"] if of["real"] and of["real"]["fate"] == "matched"]
    assert len(of_both) == len(metrics) > 0
    for of in of_both:
        row = metrics.loc[of["real"]["community_id"]]
        assert of["real"]["r_lambda"] == of["sim"]["r_lambda"] == row.r_lambda
        assert (of["real"]["n_points"], of["sim"]["n_points"]) == (row.n_real, row.n_sim)
    assert [of["real"]["r_lambda"] for of in of_both] == sorted(metrics.r_lambda, reverse=True)


@pytest.mark.parametrize("name", HOSTILE_PAIRS)
def test_the_terminal_shows_any_name_as_it_is(report_run, name):
    assert "Pairs, worst first (means over matched objects)" not in shown(report_run)
    everything = shown(report_run, "--all")
    assert "Pairs, worst first (means over matched objects)" in everything
    assert "Dataset (mean and standard deviation" in everything
    for words in ([report_run, name], [report_run, name, "0"]):
        assert name.replace(" ", "").replace("\u202e", "\\u202e") in "".join(
            shown(*words).split()
        )


def test_every_object_of_either_side_stands_in_its_pair_once(report_run):
    run_ = FinishedRun(report_run)
    found = run_.pair(FIRST)["objects"]
    objects = pd.read_parquet(report_run / "objects").query("pair_id == @FIRST")
    for side in ("real", "sim"):
        ids = sorted(of[side]["community_id"] for of in found if of[side])
        assert ids == sorted(objects[objects.side == side].community_id)


def test_an_object_is_named_by_its_side_and_number(report_run):
    run_ = FinishedRun(report_run)
    real = run_.object(FIRST, "0")
    partner = real["sim"]["community_id"]
    assert run_.object(FIRST, f"sim:{partner}") == real == run_.object(FIRST, "real:0")
    objects = run_.pair(FIRST)["objects"]
    alone = next(of for of in objects if of["real"] and of["real"]["fate"] == "not_found")
    assert alone["real"]["cdc"] is None
    assert ": not found" in " ".join(text_of(object_view(alone)).split())
    axis = plot_object(run_, FIRST, str(alone["real"]["community_id"])).axes[0]
    assert axis.get_title().endswith(", not found")


@pytest.mark.parametrize("name", ["99", "sim:99", "nose:1", "sim", "-1", "٣", ""])
def test_an_object_that_is_not_there_is_named_with_what_is(report_run, name):
    with pytest.raises(RunError, match="no object"):
        FinishedRun(report_run).object(FIRST, name)


def test_a_pair_and_its_objects_have_their_coverage(report_run):
    coverage = pd.read_parquet(report_run / "coverage").query("pair_id == @FIRST")
    stored = coverage.dropna(subset="community_id").set_index(["side", "community_id"])
    found = json.loads(shown(report_run, FIRST, "--json"))
    whole = coverage[coverage.community_id.isna()].set_index("side")
    assert found["pair"]["covered_real_0p3m"] == whole.covered_0p3m["real"]
    for of in found["objects"]:
        for side in ("real", "sim"):
            if of[side]:
                row = stored.loc[(side, of[side]["community_id"])]
                assert [of[side][name] for name in row.index[2:]] == row.tolist()[2:]
    text = shown(report_run, FIRST)
    assert f"{whole.covered_0p3m['sim']:.3f}" in text
    assert "of the real surface is simulated within 0.3 m" in text
    first = shown(report_run, FIRST, "0")
    assert f"{stored.covered_1m['real', 0]:.3f}" in first


def test_a_missing_reference_object_shows_what_little_of_it_is_simulated(by_reference):
    run_ = FinishedRun(by_reference)
    matching = pd.read_parquet(by_reference / "matching").query("pair_id == '0'")
    found = run_.pair("0")["objects"]
    real = [of["real"] for of in found if of["real"]]
    assert sorted(row["community_id"] for row in real) == sorted(matching.real_id.dropna())
    missing = [of for of in found if of["real"] and of["real"]["fate"] == "not_found"]
    (pole,) = [of for of in missing if of["sim"]["n_points"]]
    assert pole["sim"]["n_points"] == 3
    assert run_.object("0", f"sim:{pole['sim']['community_id']}") == pole
    text = shown(by_reference, "0", pole["real"]["community_id"])
    assert "3 of its points are simulated, too few to match it" in text
    assert "54 % of its points" in text
    invented = [of["sim"] for of in found if of["real"] is None]
    assert {row["fate"] for row in invented} == {"extra"}
    assert sorted(row["community_id"] for row in invented) == sorted(
        matching.query("real_id.isna()").sim_id
    )


def test_a_pair_lists_the_ten_largest_objects_of_one_side_and_with_all_every_one(report_run):
    values = FinishedRun(report_run).pair(FIRST)
    alone = next(of["sim"] for of in values["objects"] if of["real"] is None)
    values["objects"] = []
    for i in range(77):
        row = {**alone, "community_id": i, "n_points": 100 + i}
        values["objects"].append({"real": None, "sim": row})
    few = pair_view(values)
    rows = next(
        part
        for part in few
        if isinstance(part, Table) and part.title == "Objects that only one side has"
    ).rows
    assert [row[2] for row in rows] == [f"sim:{i}" for i in range(76, 66, -1)]
    assert few[-1].text == "67 more: --all"
    assert len(pair_view(values, with_all=True)[-1].rows) == 77


def test_a_failed_pair_shows_why_and_has_no_objects(report_run):
    assert "4.bin: the file is empty" in shown(report_run, BROKEN)
    assert json.loads(shown(report_run, BROKEN, "--json"))["objects"] == []


def test_the_whole_run_as_json_is_its_record_and_its_pairs(report_run):
    found = json.loads(shown(report_run, "--json"))
    assert {row["pair_id"] for row in found["pairs"]} == {*HOSTILE_PAIRS, BROKEN}
    assert found["record"] == read_run(report_run)


def test_a_name_that_is_nearly_right_is_suggested(report_run):
    result = command("show", report_run, BROKEN[1:], code=1)
    assert f"it has {BROKEN!r}" in result.stderr


def test_a_folder_without_a_finished_run_is_refused(tmp_path):
    for name, advice in (
        ("", "fidpipe run {0} SIM"),
        ("absent", "fidpipe run DATASET --out {0}"),
        ("data", "fidpipe run {0} --out runs/data"),
    ):
        (tmp_path / "data" / "real").mkdir(parents=True, exist_ok=True)
        folder = tmp_path / name
        with pytest.raises(RunError) as error:
            FinishedRun(folder)
        assert str(error.value).startswith(f"run {folder}: ")
        assert advice.format(folder) in str(error.value)
    (tmp_path / "run.json").write_text('{"dataset": "/data/streets"}')
    with pytest.raises(RunError, match=str(tmp_path)):
        FinishedRun(tmp_path)
