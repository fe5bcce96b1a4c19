"""Simulator versions on the same real scans: known differences, rejected runs, and pages that no name can break."""

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from plotly.offline import get_plotlyjs

from fidpipe.pipeline.report.page.compare_page import compare_page, draw_place
from fidpipe.pipeline.report.view import shortened
from fidpipe.pipeline.report.views.compare_view import (
    chance,
    compare_view,
    decision,
    place_words,
    reasons,
)
from fidpipe.pipeline.results.changes import Changes
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.followed import kinds_of_change, worst_changes
from fidpipe.pipeline.results.gate import judge_comparison
from fidpipe.pipeline.results.object_frame import plain_rows
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.results import ChangedCause
from fidpipe.schemas.settings import load
from reports import text_of
from runs import command, copied, run
from scenes import drifted, street, write_bin, write_pair

HOSTILE = (
    "<script>alert(1)</script>",
    "ünï[bold]code[/bold] 雨",
    "x" * 300,
    "../x",
    "x&amp;",
    "x%41 '",
)


def run_versions(folder, n=6, signs=(1, 1, 1)):
    """Runs of a good and a bad simulator on the same real scans under the hostile names; `signs` mirror the bad one."""
    for version, noise, keep, own_signs in (
        ("good", 0.02, 0.95, (1, 1, 1)),
        ("bad", 0.3, 0.6, signs),
    ):
        data = folder / f"data-{version}"
        rows = []
        for i, name in enumerate(HOSTILE[:n]):
            scan = street(seed=10 * i)
            write_bin(data / f"real{i}.bin", scan)
            write_bin(
                data / f"sim{i}.bin", drifted(scan, seed=i, noise=noise, keep=keep) * own_signs
            )
            rows.append(f'"{name}",real{i}.bin,sim{i}.bin,{60 * i}')
        (data / "pairs.csv").write_text(
            "pair_id,real,sim,timestamp_s\n" + "\n".join(rows) + "\n", encoding="utf-8"
        )
        run(data, folder / version)
    return folder / "good", folder / "bad"


@pytest.fixture(scope="module")
def versions(tmp_path_factory):
    return run_versions(tmp_path_factory.mktemp("compare"))


@pytest.fixture(scope="module")
def found(versions):
    """The comparison of both versions."""
    return compare_runs(versions)[0]


def by_name(comparison):
    return {of.name: of for of in scores_of(comparison)}


def scores_of(comparison):
    return [score for family in comparison.families for score in family.scores]


def test_a_worse_simulator_is_distinguished_from_a_better_one_both_ways(versions):
    worse = compare_runs(versions)[0]
    better = compare_runs(versions[::-1])[0]
    assert (worse.decision, better.decision) == ("worse", "better")
    assert "surface invented" in [words for words, _, _ in reasons(worse)["worse"]]
    assert by_name(worse)["CDC"].difference.difference == pytest.approx(
        -by_name(better)["CDC"].difference.difference
    )
    assert worse.kinds["worse"] > worse.kinds["better"]


def test_a_break_on_too_few_pairs_is_worse_all_the_same(tmp_path):
    folders = run_versions(tmp_path, n=5, signs=(1, -1, 1))
    found = compare_runs(folders)[0]
    assert (found.n_places, found.decision) == (5, "worse")
    assert "fewer than 6 pairs" in chance(found)
    p_values = {score.p for score in scores_of(found)}
    assert None in p_values, "no p where none can be reached"
    assert 1.0 not in p_values


def test_copies_of_one_pair_under_another_seed_are_not_better(tmp_path):
    scan = street()
    for i in range(8):
        write_pair(tmp_path / "data", scan, drifted(scan, noise=0.3, keep=0.6), i)
    runs = [tmp_path / "a", tmp_path / "b"]
    for folder, seed in zip(runs, (1, 2), strict=True):
        run(tmp_path / "data", folder, load(assignments=[f"communities.seed={seed}"]))
    found = compare_runs(runs, allow_different_settings=True)[0]
    assert (len(found.pairs), found.n_places) == (8, 1)
    assert {one.verdict for one in scores_of(found)} <= {"undecided", "same"}
    assert found.counted == "8 neighbouring frames of one place (by comparing the scans)"


def test_scans_near_each_other_in_time_count_once(versions, tmp_path):
    folders = []
    for own in versions:
        data, out = copied(own.with_name(f"data-{own.name}"), own, tmp_path / own.name)
        manifest = (data / "pairs.csv").read_text("utf-8")
        (data / "pairs.csv").write_text(
            re.sub(r",(\d+)\n", lambda own: f",{int(own[1]) / 300}\n", manifest), "utf-8"
        )
        run(data, out)
        shutil.rmtree(data)  # the same where the dataset is not
        folders.append(out)
    found = compare_runs(folders)[0]
    assert (len(found.pairs), found.n_places) == (6, 1)
    assert {family.verdict for family in found.families} <= {"undecided", "same"}
    assert found.counted == "6 neighbouring frames of one place (by time stamps)"
    assert "--independent" in chance(found)
    alone = compare_runs(folders, independent=True)[0]
    assert (alone.n_places, alone.decision) == (6, "worse")
    assert "about these scans" in alone.counted


def test_differences_are_those_of_the_tables(found, versions):
    good = pd.read_parquet(versions[0] / "pairs.parquet").set_index("pair_id")
    bad = pd.read_parquet(versions[1] / "pairs.parquet").set_index("pair_id")
    for column, name in (("match_rate", "match rate"), ("cdc_mean", "CDC")):
        change = bad[column] - good[column]
        of = by_name(found)[name]
        assert of.difference.difference == pytest.approx(change.mean())
        assert of.difference.low <= change.mean() <= of.difference.high
    assert by_name(found)["CDC"].difference.n_pairs == len(HOSTILE)


def test_objects_are_followed_through_the_real_side(found, versions):
    assert found.unfollowed == ()
    real = pd.read_parquet(versions[0] / "objects").query("side == 'real'")
    assert len(found.objects) == len(real) == sum(found.kinds.values())
    matching = [
        pd.read_parquet(folder / "matching").query("status == 'matched'") for folder in versions
    ]
    matched = [set(zip(of.pair_id, of.real_id.astype(int), strict=True)) for of in matching]
    of_kind = {
        kind: set(zip(own.pair_id, own.real_id, strict=True))
        for kind, own in found.objects.groupby("kind")
    }
    vanished = of_kind["vanished"]
    appeared = of_kind["appeared"]
    assert vanished == matched[0] - matched[1]
    assert appeared == matched[1] - matched[0]
    metrics = pd.read_parquet(versions[1] / "metrics").set_index(["pair_id", "real_id"]).cdc
    for of in plain_rows(found.objects):
        assert of["cdc_after"] == (metrics.get((of["pair_id"], of["real_id"])))


def test_the_kind_of_change_of_an_object_by_hand():
    nan = np.nan
    rows = [
        (-1, -1, nan, nan, nan, nan, "not found in both"),
        (0, -1, 0.1, nan, 0.1, nan, "vanished"),
        (-1, 0, nan, 0.1, nan, 0.1, "appeared"),
        (0, 0, 0.5, 0.4, 0.3, 0.3, "better"),
        (0, 0, 0.5, 0.5, 0.3, 0.4, "worse"),
        (0, 0, 0.5, 0.4, 0.3, 0.4, "mixed"),
        (0, 0, 0.5, 0.46, 0.3, 0.34, "alike"),
        (0, 0, 0.5, 0.4, nan, 0.9, "better"),
    ]
    columns = [
        f"{name}_{when}"
        for name in ("partner", "cdc", "r_lambda")
        for when in ("before", "after")
    ]
    objects = pd.DataFrame(rows, columns=[*columns, "kind"])
    assert kinds_of_change(objects).tolist() == objects.kind.tolist()


def test_other_settings_are_rejected_unless_allowed(versions, tmp_path):
    other = shutil.copytree(versions[1], tmp_path / "other")
    run(versions[1].parent / "data-bad", other, load(assignments=["matching.delta_m=3"]))
    with pytest.raises(RunError, match=r"matching.delta_m is 5.0 and 3.0"):
        compare_runs([versions[0], other])
    found = compare_runs([versions[0], other], allow_different_settings=True)[0]
    assert found.settings == ("matching.delta_m is 5.0 and 3.0",)
    assert found.unfollowed == ()


def test_other_communities_of_the_same_scan_are_not_followed(versions, tmp_path):
    other = tmp_path / "other"
    run(versions[1].parent / "data-bad", other, load(assignments=["graph.k=10"]))
    found = compare_runs([versions[0], other], allow_different_settings=True)[0]
    assert set(found.unfollowed) == set(HOSTILE)
    assert found.objects.empty
    assert worst_changes(found.objects) == []


def test_pairs_that_are_not_common_are_left_out_with_the_reason(versions, tmp_path):
    data = shutil.copytree(versions[1].parent / "data-bad", tmp_path / "data")
    write_bin(data / "real0.bin", street(seed=99))
    (data / "sim1.bin").write_bytes(b"")
    run(data, tmp_path / "run", pattern="[!x]*")
    found = compare_runs([versions[0], tmp_path / "run"])[0]
    assert found.pairs == (HOSTILE[3],)
    assert found.failed == (HOSTILE[1],)
    assert set(found.lost) == set(HOSTILE) - {HOSTILE[3]}
    assert found.left_out.keys() == set(HOSTILE) - {HOSTILE[3]}
    assert str(data / "sim1.bin") in found.left_out[HOSTILE[1]]
    assert {score.verdict for score in scores_of(found)} == {"undecided"}
    assert {score.difference.low for score in scores_of(found)} == {None}


def test_runs_without_a_common_pair_are_refused(versions, finished):
    with pytest.raises(RunError, match="no pair"):
        compare_runs([versions[0], finished])


def test_the_command_compares_three_runs_and_writes_a_page(versions, tmp_path):
    good, bad = versions
    result = command("compare", good, bad, good, "--html", tmp_path / "page.html", code=0)
    assert f"{bad} against {good}" in " ".join(result.stdout.split())
    assert (tmp_path / "page.html").stat().st_size < len(get_plotlyjs()) + 400_000
    found = json.loads(command("compare", good, bad, "--json").stdout)
    assert found[0]["pairs"] == sorted(HOSTILE)


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags = []
        self.text = []
        self.links = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.text.append(data)


def test_no_name_reaches_the_page_as_markup_and_nothing_is_fetched(versions):
    comparison = compare_runs(versions, independent=True)[0]
    text = compare_page([comparison])
    page = Tags()
    page.feed(text)
    assert page.tags.count("script") == 3, "the data, plotly.js and the page's own code"
    assert not {"bold", "img", "iframe"} & set(page.tags)
    assert [link for link in page.links if not link.startswith("#")] == ["data:,"]
    assert "default-src 'none'" in text
    worst = worst_changes(comparison.objects)
    in_3d = {
        f"{place_words(row)}, pair {row['pair_id']}, object {row['real_id']}" for row in worst
    }
    assert in_3d == {words for words in page.text if re.search(r", object \d+$", words)}
    assert {HOSTILE[0], HOSTILE[2], HOSTILE[4], HOSTILE[5]} <= {row["pair_id"] for row in worst}
    first = worst[:3]
    names = shortened({row["pair_id"] for row in first}, 24)
    where = [f"{names[row['pair_id']]}  {place_words(row)}" for row in first]
    shown = [words.strip() for words in page.text]
    start = shown.index("Where")
    assert [words for words in shown[start + 1 :] if words][:3] == where


def test_the_first_line_is_the_decision_with_its_first_cause_and_short(versions):
    for order, word in (
        (versions, "worse"),
        (versions[::-1], "better"),
        ([versions[0]] * 2, "same"),
    ):
        found = compare_runs(order)[0]
        assert decision(found).startswith(f"{word}: ")
        assert len(decision(found)) < 80
        text = " ".join(text_of(compare_view(found)).split())
        assert text.startswith(f"{word}: ")
        assert chance(found).startswith("6 pairs of 6 places")


def test_the_first_line_names_what_changed_neither_for_better_nor_worse(versions):
    found = compare_runs([versions[0]] * 2)[0]
    cause = ChangedCause(
        name="height",
        kind="sensor",
        words="height: +2 cm, before -2 cm",
        setting="mount height",
        estimate=0.05,
        low=0.04,
        high=0.06,
        unit="m",
        n_pairs=6,
        real=None,
        sim=None,
        share=1.0,
        before=-0.025,
        after=0.025,
        verdict="changed",
    )
    found = replace(found, changes=Changes((cause,)), families=())
    assert decision(found) == f"undecided: changed, neither better nor worse: {cause.words}"


def test_tables_fit_80_columns_and_a_name_takes_one_line(versions):
    short = text_of(compare_view(compare_runs(versions)[0], with_all=False))
    text = text_of(compare_view(compare_runs(versions)[0], with_all=True))
    assert max(map(len, (short + text).splitlines())) <= 80
    assert len(short.splitlines()) < 40 < len(text.splitlines())
    rows = [line for line in text.splitlines() if "xxxx" in line]
    assert rows
    assert all("…" in row and "m away: " in row for row in rows), "a name is broken"


def test_the_table_holds_the_scores_and_the_terminal_the_families(found):
    rows = found.table
    scores = scores_of(found)
    assert rows["name"].tolist() == [score.name for score in scores]
    assert rows["difference"].tolist() == [score.difference.difference for score in scores]
    (match_rate,) = rows[rows["name"] == "match rate"].to_dict("records")
    assert (match_rate["family"], match_rate["mark"]) == ("objects", "↑")
    text = text_of(compare_view(found, with_all=True), 200)
    assert text.startswith("worse: ")
    assert re.search("surface invented +worse ", text)


@pytest.mark.exhaustive
def test_the_worst_changes_are_in_3d(versions):
    found = compare_runs(versions)
    worst = worst_changes(found[0].objects)
    assert 0 < len(worst) <= 5
    assert {one["kind"] for one in worst} <= {"worse", "vanished"}
    page = Tags()
    page.feed(compare_page(found))
    assert page.tags.count("option") >= len(worst) + 3, "and three themes"


def test_a_changed_object_has_its_points_before_and_after(found, versions):
    one = next(change for change in plain_rows(found.objects) if change["kind"] == "vanished")
    place = draw_place([*map(FinishedRun, versions)], one["pair_id"], one["real_id"])
    assert all(len(axis) >= one["n_points"] for axis in place["real"])
    for sim in place["sims"]:
        x, y, z = sim["points"]
        assert len(x) == len(y) == len(z) == len(sim["signed_m"])
        assert all(value is None or abs(value) <= 0.5 for value in sim["signed_m"])


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_first_place_is_around_the_sensor_if_the_first_cause_is_of_the_sensor(
    versions, order
):
    found = compare_runs([versions[i] for i in order])
    causes = [change for change in found[0].changes.causes if change.kind == "sensor"]
    first = compare_page(found).partition('<option value="0">')[2].partition("<")[0]
    assert ("around the sensor" in first) == bool(causes)


def test_a_gate_against_a_base_fails_on_a_worse_score_and_writes_what_ci_reads(
    versions, tmp_path
):
    good, bad = versions
    passed = command(
        "compare", good, good, "--fail-on", "worse", "--out", tmp_path / "same", code=0
    )
    assert "gate on worse: passed" in passed.stdout
    command("compare", good, bad, "--fail-on", "worse", "--out", tmp_path, code=4)
    assert (
        command(
            "compare", bad, good, "--fail-on", "worse", "--out", tmp_path / "better"
        ).returncode
        == 0
    )
    (judged,) = json.loads((tmp_path / "compare.json").read_text())["comparisons"]
    assert (judged["decision"], judged["passed"]) == ("worse", False)
    faults = {check["name"]: check["fault"] for check in judged["checks"]}
    worse = {
        f"{family['name']} is not worse"
        for family in judged["families"]
        if family["verdict"] == "worse" and not family["why"]
    } | {
        f"{cause['name']} is not worse"
        for cause in judged["causes"]
        if cause["verdict"] == "worse"
    }
    assert {name for name, fault in faults.items() if fault} == worse > set()
    suite = ElementTree.parse(tmp_path / "compare.xml").getroot().find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == (str(len(faults)), str(len(worse)))
    assert {
        case.get("name") for case in suite.iter("testcase") if case.find("failure") is not None
    } == {name for name, fault in faults.items() if fault}
    assert {path.name for path in (tmp_path / "same").iterdir()} == {
        "compare.html",
        "compare.json",
        "compare.xml",
    }


def test_a_pair_that_is_no_longer_scored_fails_a_gate_though_all_others_are_the_same(
    versions, tmp_path
):
    data, out = copied(versions[0].parent / "data-good", versions[0], tmp_path)
    (data / "sim1.bin").write_bytes(b"")
    run(data, out)
    (found,) = compare_runs([versions[0], tmp_path / "run"])
    assert found.failed == found.lost == (HOSTILE[1],)
    assert {score.verdict for score in scores_of(found)} == {"same"}
    assert found.decision == "worse"
    assert decision(found).startswith("worse: 1 of 6 pairs")
    result = judge_comparison(found, "worse")
    (failed,) = result.failed
    assert HOSTILE[1] in failed.found
    assert (
        judge_comparison(compare_runs([tmp_path / "run", versions[0]])[0], "worse").failed == ()
    )


def test_a_run_in_which_every_pair_fails_is_worse_and_leaves_files_for_ci(versions, tmp_path):
    data = shutil.copytree(versions[0].parent / "data-good", tmp_path / "data")
    for i in range(len(HOSTILE)):
        (data / f"sim{i}.bin").write_bytes(b"")
    run(data, tmp_path / "run")
    result = command("compare", versions[0], tmp_path / "run", "--fail-on", "worse", code=4)
    assert result.stdout.startswith("worse: all 6 pairs")
    assert (tmp_path / "run" / "compare.xml").exists()
    assert (
        json.loads((tmp_path / "run" / "compare.json").read_text())["comparisons"][0][
            "decision"
        ]
        == "worse"
    )
    page = compare_page(compare_runs([versions[0], tmp_path / "run"]))
    assert "all 6 pairs" in page


def test_undecided_fails_whatever_the_reason_is(found):
    tendencies = {"objects": "worse"}
    open_ = tuple(
        replace(family, verdict="undecided", tendency=tendencies.get(family.name, ""))
        for family in found.families
    )
    for n_places in (5, 8):
        unsure = replace(found, n_places=n_places, families=open_, changes=Changes())
        assert unsure.decision == "undecided"
        passed = judge_comparison(unsure, "worse", undecided_ok=True)
        assert passed.failed == ()
        faults = [check.fault for check in judge_comparison(unsure, "worse").failed]
        assert faults == (["undecided"] if n_places == 5 else []), (
            "too few places fail, chance does not"
        )
        assert [check.fault for check in judge_comparison(unsure, "undecided").failed] == [
            "undecided"
        ]
    mixed = replace(
        found, families=(replace(found.families[0], verdict="mixed"),), changes=Changes()
    )
    assert [check.fault for check in judge_comparison(mixed, "worse").failed] == ["mixed"]


def test_tasks_are_said_to_be_unknown_by_direction(found):
    tasks = replace(found.families[0], name="tasks", verdict="undecided")
    few = replace(found, by_direction=True, families=(tasks,))
    text = " ".join(text_of(compare_view(few)).split())
    assert "tasks: undecided, as they are not known by direction: needs 9 places" in text


def test_datasets_are_evaluated_and_compared(tmp_path):
    for i, name in enumerate(("a", "b")):
        write_bin(tmp_path / name / "real" / "0.bin", scan := street(seed=0, n=80))
        write_bin(tmp_path / name / "sim" / "0.bin", drifted(scan, seed=i))
    missing = command("compare", "a", "typo", cwd=tmp_path)
    assert missing.returncode == 1
    assert "typo" in missing.stderr
    assert not (tmp_path / "runs").exists()
    ended = command("compare", "a", "b", "--json", cwd=tmp_path, env=None, code=0)
    assert "its run is runs/a" in ended.stderr
    assert json.loads(ended.stdout)[0]["other"] == "runs/b"
    assert FinishedRun(tmp_path / "runs" / "a").preset == "reference"
