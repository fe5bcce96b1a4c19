"""Simulator versions on the same real scans: known differences, refusals, and pages that no name can break."""

import json
import shutil
from html.parser import HTMLParser

import pandas as pd
import pytest
from plotly.offline import get_plotlyjs

from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.report.page.compare import compare_page
from fidpipe.pipeline.report.terminal.compare import (
    compare_csv,
    compare_markdown,
    compare_view,
    decision,
    remarks,
    score_table,
    verdict,
    with_arrow,
)
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.settings import load
from reports import embedded
from runs import command, run
from scenes import drifted, street, write_bin

HOSTILE = ("<script>alert(1)</script>", "ünï[bold]code[/bold] 雨", "x" * 300, "../x", "x&amp;", "x%41 '")


def write_version(folder, noise, keep):
    """A dataset of the six hostile names: the real scans are the same in every version."""
    rows = []
    for i, name in enumerate(HOSTILE):
        scan = street(seed=10 * i)
        write_bin(folder / f"real{i}.bin", scan)
        write_bin(folder / f"sim{i}.bin", drifted(scan, seed=i, noise=noise, keep=keep))
        rows.append(f'"{name}",real{i}.bin,sim{i}.bin')
    (folder / "pairs.csv").write_text("pair_id,real,sim\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def versions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    for name, noise, keep in (("good", 0.02, 0.95), ("bad", 0.3, 0.6)):
        run(write_version(folder / f"data-{name}", noise, keep), folder / name)
    return folder / "good", folder / "bad"


def by_name(comparison):
    return {of.name: of for of in comparison.scores}


def test_a_worse_simulator_is_told_from_a_better_one_both_ways(versions):
    worse, better = (compare_runs(order)[0] for order in (versions, versions[::-1]))
    for found, word in ((worse, "worse"), (better, "better")):
        assert by_name(found)["CDC (objects in both)"].verdict == word
        assert verdict(found).startswith(f"{word}: ")
        assert any(line.startswith("what seeds alone make is unknown of ") for line in remarks(found))
    assert by_name(worse)["CDC"].difference.difference == pytest.approx(-by_name(better)["CDC"].difference.difference)
    assert worse.kinds["worse"] > worse.kinds["better"]


def test_a_break_on_too_few_pairs_is_said_in_words(versions, tmp_path):
    folders = []
    for version in versions:
        data = shutil.copytree(version.parent / f"data-{version.name}", tmp_path / f"data-{version.name}")
        if version.name == "bad":
            for i in range(len(HOSTILE)):
                write_bin(data / f"sim{i}.bin", read_scan(data / f"sim{i}.bin").points * [1, -1, 1])
        lines = (data / "pairs.csv").read_text(encoding="utf-8").splitlines()
        (data / "pairs.csv").write_text("\n".join(lines[:6]) + "\n", encoding="utf-8")
        folders.append(tmp_path / version.name)
        run(data, folders[-1])
    found = compare_runs(folders)[0]
    assert found.n_blocks == 5
    assert {one.verdict for one in found.scores} == {"undecided"}
    assert "no score is decidedly" not in verdict(found)
    assert "far beyond the noise, though 5 independent pairs decide nothing: worse: " in verdict(found)


def test_copies_of_one_pair_under_another_seed_are_not_better(tmp_path):
    scan = street()
    for i in range(8):
        write_bin(tmp_path / "data" / "real" / f"{i}.bin", scan)
        write_bin(tmp_path / "data" / "sim" / f"{i}.bin", drifted(scan, noise=0.3, keep=0.6))
    runs = [tmp_path / "a", tmp_path / "b"]
    for folder, seed in zip(runs, (1, 2), strict=True):
        run(tmp_path / "data", folder, load(assignments=[f"communities.seed={seed}"]))
    found = compare_runs(runs, allow_different_settings=True)[0]
    assert (len(found.pairs), found.n_blocks) == (8, 1)
    assert {one.verdict for one in found.scores} <= {"undecided", "same"}
    assert not any(one.is_far for one in found.scores)
    assert any(line.startswith("8 pairs count as 1: copies of a real scan") for line in remarks(found))


def test_scans_near_each_other_in_time_count_once(versions, tmp_path):
    folders = []
    for version in versions:
        data = shutil.copytree(version.parent / f"data-{version.name}", tmp_path / f"data-{version.name}")
        rows = [f'"{name}",real{i}.bin,sim{i}.bin,{0.2 * i}' for i, name in enumerate(HOSTILE)]
        (data / "pairs.csv").write_text("pair_id,real,sim,timestamp_s\n" + "\n".join(rows) + "\n", encoding="utf-8")
        folders.append(tmp_path / version.name)
        run(data, folders[-1])
    found = compare_runs(folders)[0]
    assert (len(found.pairs), found.n_blocks) == (6, 1)
    assert {one.verdict for one in found.scores} == {"undecided"}
    assert verdict(found).startswith("13 of 33 objects that were matched have vanished")


def test_differences_are_those_of_the_tables(versions):
    found = compare_runs(versions)[0]
    good, bad = (pd.read_parquet(folder / "pairs.parquet").set_index("pair_id") for folder in versions)
    for column, name in (("match_rate", "match rate"), ("cdc_mean", "CDC"), ("n_missing", "missing objects")):
        change = bad[column] - good[column]
        of = by_name(found)[name]
        assert of.of_pairs == pytest.approx(change.to_dict())
        assert of.difference.difference == pytest.approx(change.mean())
        assert of.difference.low <= change.mean() <= of.difference.high


def test_a_score_says_of_how_many_pairs_its_means_are(versions):
    found = compare_runs(versions)[0]
    headings, *rows = score_table(found)
    assert [row[headings.index("pairs")] for row in rows] == [str(one.difference.n_pairs) for one in found.scores]
    assert by_name(found)["CDC"].difference.n_pairs == len(HOSTILE)


def test_objects_are_followed_through_the_real_side(versions):
    found = compare_runs(versions)[0]
    assert found.unfollowed == ()
    real = pd.read_parquet(versions[0] / "objects").query("side == 'real'")
    assert len(found.objects) == len(real) == sum(found.kinds.values())
    matching = [pd.read_parquet(folder / "matching").query("status == 'matched'") for folder in versions]
    matched = [set(zip(of.pair_id, of.real_id.astype(int), strict=True)) for of in matching]
    vanished = {(of.pair_id, of.real_id) for of in found.objects if of.kind == "vanished"}
    appeared = {(of.pair_id, of.real_id) for of in found.objects if of.kind == "appeared"}
    assert vanished == matched[0] - matched[1]
    assert appeared == matched[1] - matched[0]
    metrics = pd.read_parquet(versions[1] / "metrics").set_index(["pair_id", "real_id"]).cdc
    for of in found.objects:
        assert of.cdc_after == (metrics.get((of.pair_id, of.real_id)))


def test_a_run_against_itself_differs_in_nothing(versions):
    found = compare_runs([versions[0], versions[0]])[0]
    assert {of.verdict for of in found.scores} == {"same"}
    assert {kind for kind, n in found.kinds.items() if n} <= {"alike", "missing in both"}


def test_other_settings_are_refused_unless_told(versions, tmp_path):
    other = tmp_path / "other"
    run(versions[1].parent / "data-bad", other, load(assignments=["matching.delta_m=3"]))
    with pytest.raises(RunError, match=r"matching.delta_m is 5.0 and 3.0.*--allow-different-settings"):
        compare_runs([versions[0], other])
    found = compare_runs([versions[0], other], allow_different_settings=True)[0]
    assert found.settings == ("matching.delta_m is 5.0 and 3.0",)
    assert found.unfollowed == ()


def test_other_communities_of_the_same_scan_are_not_followed(versions, tmp_path):
    other = tmp_path / "other"
    run(versions[1].parent / "data-bad", other, load(assignments=["graph.k=10"]))
    found = compare_runs([versions[0], other], allow_different_settings=True)[0]
    assert set(found.unfollowed) == set(HOSTILE)
    assert found.objects == ()
    assert by_name(found)["CDC (objects in both)"].difference.difference is None


def test_pairs_that_are_not_common_are_left_out_with_the_reason(versions, tmp_path):
    data = shutil.copytree(versions[1].parent / "data-bad", tmp_path / "data")
    write_bin(data / "real0.bin", street(seed=99))
    (data / "sim1.bin").write_bytes(b"")
    run(data, tmp_path / "run", pattern="[!x]*")
    found = compare_runs([versions[0], tmp_path / "run"])[0]
    assert found.pairs == (HOSTILE[3],)
    assert found.failed == (HOSTILE[1],)
    assert set(found.lost) == set(HOSTILE) - {HOSTILE[3]}
    assert found.left_out == {
        HOSTILE[0]: "the real scans differ",
        HOSTILE[1]: f"failed in {tmp_path / 'run'} ({data / 'sim1.bin'}: the file is empty, points are wanted)",
        **{HOSTILE[i]: f"not in {tmp_path / 'run'}" for i in (2, 4, 5)},
    }
    assert by_name(found)["CDC"].verdict == "undecided"
    note = next(line for line in remarks(found) if line.startswith("undecided: match rate, "))
    assert note.endswith("1 pair is too few for a 95 % interval, 6 are wanted")


def test_runs_without_a_common_pair_are_refused(versions, tmp_path):
    data = tmp_path / "data"
    write_bin(data / "real" / "a.bin", street())
    write_bin(data / "sim" / "a.bin", drifted(street()))
    run(data, tmp_path / "run")
    with pytest.raises(RunError, match="no pair can be compared"):
        compare_runs([versions[0], tmp_path / "run"])


@pytest.mark.slow
def test_the_command_compares_three_runs_and_writes_a_page(versions, tmp_path):
    good, bad = versions
    result = command("compare", good, bad, good, "--html", tmp_path / "page.html")
    assert result.returncode == 0, result.stderr
    assert f"{bad} against {good}: " in result.stdout
    assert (tmp_path / "page.html").stat().st_size < len(get_plotlyjs()) + 200_000
    found = json.loads(command("compare", good, bad, "--json").stdout)
    assert found[0]["pairs"] == sorted(HOSTILE)
    assert command("compare", good).returncode == 2


class Tags(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.text, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.text.append(data)


def test_no_name_reaches_the_page_as_markup_and_nothing_is_fetched(versions):
    text = compare_page(compare_runs(versions))
    page = Tags()
    page.feed(text)
    assert page.tags.count("script") == 3, "the data, plotly.js and the page's own code"
    assert not {"bold", "img", "iframe"} & set(page.tags)
    assert page.links == ["data:,"]
    assert "default-src 'none'" in text
    for name in HOSTILE:
        assert name in page.text


def test_the_chart_has_a_dot_for_each_pair_and_the_interval_of_each_score(versions):
    found = compare_runs(versions)
    chart = embedded(compare_page(found))["charts"]["changes_0"]
    dots, intervals = ([of for of in chart["data"] if ("error_x" in of) == is_bar] for is_bar in (False, True))
    assert [len(of["x"]) for of in dots] == [
        sum(value is not None for value in of.of_pairs.values()) for of in found[0].scores
    ]
    assert len(intervals) == sum(of.difference.low is not None for of in found[0].scores) > 0
    assert chart["layout"]["yaxis"]["ticktext"] == [with_arrow(of) for of in found[0].scores]
    assert all(abs(x) <= 1 for of in dots for x in of["x"])


@pytest.mark.slow
def test_a_difference_is_set_beside_what_seeds_alone_make(versions, tmp_path):
    runs = []
    for name in ("good", "bad"):
        runs.append(shutil.copytree(versions[0].parent / name, tmp_path / name))
        run(versions[0].parent / f"data-{name}", runs[-1], load(assignments=["stability.seeds=3"]))
    found = by_name(compare_runs(runs)[0])
    of_seeds = [json.loads((folder / "run.json").read_text())["seeds"]["dataset"]["cdc_mean"] for folder in runs]
    noise = sum(of["least_dataset"] ** 2 for of in of_seeds) ** 0.5 / 2**0.5
    assert found["CDC"].seed_noise == pytest.approx(noise)
    assert found["CDC"].beyond_seeds == (found["CDC"].difference.difference > noise)
    assert found["CDC (objects in both)"].beyond_seeds is None
    assert by_name(compare_runs(versions)[0])["CDC"].seed_noise is None
    assert "more than seeds make" in compare_page(compare_runs(runs))
