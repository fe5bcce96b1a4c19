"""The report of a run: what it reads and refuses, what it says, and that no name can break it."""

import base64
import json
import os
import re
import shutil
from io import StringIO
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from rich.console import Console

from fidpipe.pipeline.report.aggregates import histograms, quadrants
from fidpipe.pipeline.report.charts import run_charts
from fidpipe.pipeline.report.figures.run import draw_coverage
from fidpipe.pipeline.report.look import RAMPS, SIDE_COLOURS
from fidpipe.pipeline.report.page.data import page_data, page_words, pair_view, thinned
from fidpipe.pipeline.report.page.page import MOST_VIEWS, some_of, write_report
from fidpipe.pipeline.report.page.render import render
from fidpipe.pipeline.report.results import PairTables, read_results
from fidpipe.pipeline.report.terminal.run import summary_view
from fidpipe.pipeline.report.verdict import verdict_of
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.settings import load
from fidpipe.stages.metrics import IDENTICAL_CHANGE
from reports import HOSTILE_CLASS, HOSTILE_PAIRS, embedded
from runs import assert_same_tables, command, run
from scenes import street, write_bin, write_dataset

FIGURES = {"overview", "coverage", "unmatched", "distributions", "box_plots", "objects"}


@pytest.fixture
def copied_run(report_run, tmp_path):
    return shutil.copytree(report_run, tmp_path / "run")


@pytest.fixture(scope="module")
def written(report_run, tmp_path_factory):
    folder = shutil.copytree(report_run, tmp_path_factory.mktemp("written") / "run")
    return write_report(folder)


def coverage_of(folder):
    """The rows of objects in the table of coverage."""
    coverage = pd.read_parquet(folder / "coverage")
    return coverage[coverage.community_id.notna()].set_index(["pair_id", "side", "community_id"])


def close_to(picture, colour):
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return np.abs(picture - rgb).max(axis=2) < 60


def words(page):
    """What a reader sees of a page without its scripts."""
    return page.read_text("utf-8").partition('<script type="application/json"')[0]


@pytest.mark.slow
def test_the_report_is_one_page_and_six_figures_as_png_and_svg(written):
    assert written.page.name == "report.html"
    assert written.page.stat().st_size < 15e6
    assert {path.name for path in written.figures} == {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg")}
    for path in written.figures:
        if path.suffix == ".png":
            assert np.asarray(Image.open(path).convert("L")).std() > 5, "an empty picture"
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


@pytest.mark.slow
def test_the_figure_of_objects_shows_points_of_both_sides(written):
    path = next(path for path in written.figures if path.name == "objects.png")
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    for side, colour in SIDE_COLOURS.items():
        assert close_to(picture, colour).sum() > 200, side


@pytest.mark.slow
def test_the_map_of_surfaces_has_what_is_missing_left_and_what_is_invented_right(by_reference, tmp_path):
    results = read_results(by_reference)
    path, _ = draw_coverage(results, results.pairs.pair_id[0], tmp_path)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    near, far = (close_to(picture, RAMPS["light"][end]) for end in (0, -1))
    left, right = np.split(np.arange(int(0.85 * picture.shape[1])), [int(0.47 * picture.shape[1])])
    assert near[:, left].sum() > 200
    assert near[:, right].sum() > 200
    assert far[:, left].sum() > 3 * far[:, right].sum() > 100, "seven objects are missing, one is invented"


def test_the_head_of_the_page_names_the_preset_and_what_departs_from_it(report_run, by_reference):
    paper, reference = (page_words(read_results(folder))["preset"] for folder in (report_run, by_reference))
    assert paper.startswith("preset paper (")
    assert "but" not in paper
    assert reference.startswith("preset reference (")
    assert reference.endswith("), but graph.k=20")


@pytest.mark.parametrize("run_of", ["report_run", "by_reference"])
def test_the_verdict_says_of_unmatched_objects_whether_their_surface_is_there(run_of, request):
    folder = request.getfixturevalue(run_of)
    matching, covered = pd.read_parquet(folder / "matching"), coverage_of(folder).covered_0p3m
    pairs = pd.read_parquet(folder / "pairs.parquet").query("status == 'scored'")
    said = verdict_of(read_results(folder)).unmatched
    for status, side in (("missing", "real"), ("hallucinated", "sim")):
        alone = matching[matching.status == status]
        shares = covered.loc[[(row.pair_id, side, row[f"{side}_id"]) for _, row in alone.iterrows()]]
        there, absent = ((shares > 0.8).sum() / len(pairs), (shares <= 0.2).sum() / len(pairs))
        total = len(alone) / len(pairs)
        assert total > 0
        if absent == total:
            assert f"The {total:.1f} {status} objects a pair are all absent" in said
        else:
            assert f"Of {total:.1f} {status} objects a pair, {there:.1f} are there" in said
            assert f"{total - there - absent:.1f} partly, {absent:.1f} absent." in said


def test_the_verdict_has_coverage_displacement_and_roughness_over_pairs(by_reference):
    pairs = pd.read_parquet(by_reference / "pairs.parquet")
    verdict = verdict_of(read_results(by_reference))
    assert f"displaced by {pairs.shift_m.mean():.3f} m a pair" in verdict.surface
    assert f"roughness is {pairs.roughness_sim_m.mean():.3f} m, that of the real one" in verdict.surface
    headings, real, sim = verdict.coverage
    assert headings[1:] == ["within 0.1 m", "within 0.3 m", "within 1 m"]
    for side, row in (("real", real), ("sim", sim)):
        for cell, reach in zip(row[1:], ("0p1m", "0p3m", "1m"), strict=True):
            column = pairs[f"covered_{side}_{reach}"]
            assert cell == f"{column.mean():.3f} ± {column.std(ddof=1):.3f}"


@pytest.mark.parametrize("run_of", ["report_run", "by_reference"])
def test_every_object_of_the_table_has_its_coverage(run_of, request):
    folder = request.getfixturevalue(run_of)
    stored = coverage_of(folder).covered_0p3m
    table = page_data(read_results(folder))["objects"]
    assert next(own for own in table["columns"] if own["key"] == "covered_real_0p3m")["about"].startswith(
        "covered_real"
    )
    rows = [dict(zip((own["key"] for own in table["columns"]), row, strict=True)) for row in table["rows"]]
    for row in rows:
        ids = dict(name.split() for name in row["object"].split(", "))
        for side in ("real", "sim"):
            found = row[f"covered_{side}_0p3m"]
            assert (found is None) == (side not in ids)
            if side in ids:
                assert found == pytest.approx(stored[row["pair_id"], side, int(ids[side])], abs=1e-6)
    objects = pd.read_parquet(folder / "matching")
    assert len(rows) == len(objects) > 0


@pytest.mark.parametrize("run_of", ["report_run", "by_reference"])
def test_points_in_the_page_have_the_distances_that_the_stored_coverage_is_of(run_of, request):
    results = read_results(request.getfixturevalue(run_of))
    pair = results.pairs.iloc[0]
    tables, view = PairTables(results, pair.pair_id), pair_view(results, pair.pair_id)
    for side, distance_m in tables.distances_m.items():
        for reach_m, reach in ((0.1, "0p1m"), (0.3, "0p3m"), (1.0, "1m")):
            assert (distance_m <= reach_m).mean() == pytest.approx(pair[f"covered_{side}_{reach}"], abs=1e-12)
        shown = np.frombuffer(base64.b64decode(view["sides"][side]["distance"]), np.uint8) / 255
        kept = thinned(tables.clouds[side].community, 9000)
        assert np.abs(shown - np.minimum(distance_m[kept], 1)).max() <= 0.5 / 255 + 1e-12


@pytest.mark.slow
def test_no_name_ends_a_script_or_opens_a_tag(written):
    text = written.page.read_text("utf-8")
    assert "alert(1)" in text, "the names are there"
    assert "<script>alert" not in text
    assert "<img src=x" not in text
    data = embedded(written.page.read_text("utf-8"))
    assert sorted(data["names"]) == sorted(HOSTILE_PAIRS)
    assert HOSTILE_CLASS in {row[2] for row in data["objects"]["rows"]}


@pytest.mark.slow
def test_the_page_asks_for_nothing_from_elsewhere(written):
    assert "default-src 'none'" in words(written.page).partition("<body>")[0]
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", words(written.page))


@pytest.mark.slow
def test_a_folder_of_pages_has_safe_file_names_and_drops_pages_of_pairs_that_are_gone(copied_run):
    stale = copied_run / "report" / "pair-gone.html"
    stale.parent.mkdir()
    stale.write_text("old")
    made = write_report(copied_run, one_page_a_pair=True)
    names = sorted(path.name for path in (copied_run / "report").iterdir())
    assert made.page == copied_run / "report" / "index.html"
    assert len(names) == len(HOSTILE_PAIRS) + 2
    assert not stale.exists()
    assert all(re.fullmatch(r"[\w.~%-]{1,140}", name, re.ASCII) for name in names)
    links = embedded(made.page.read_text("utf-8"))["links"]
    assert {link.replace("%25", "%") for link in links.values()} == {n for n in names if n.startswith("pair-")}
    assert sorted(path.name for path in copied_run.parent.iterdir()) == ["run"]


@pytest.mark.slow
def test_a_report_leaves_nothing_of_an_earlier_one_and_keeps_what_is_not_its_own(copied_run, monkeypatch):
    write_report(copied_run, one_page_a_pair=True)
    notes = copied_run / "report" / "notes.txt"
    notes.write_text("mine")
    (copied_run / "figures" / "mine.png").write_bytes(b"")
    monkeypatch.setattr("fidpipe.pipeline.report.figures.run.draw_objects", lambda results, folder: [])
    write_report(copied_run)
    assert [path.name for path in notes.parent.iterdir()] == ["notes.txt"]
    assert {path.stem for path in (copied_run / "figures").iterdir()} == FIGURES - {"objects"} | {"mine"}
    notes.unlink()
    write_report(copied_run)
    assert not notes.parent.exists()
    write_report(copied_run, one_page_a_pair=True)
    assert not (copied_run / "report.html").exists()


@pytest.mark.slow
def test_a_run_after_a_report_neither_removes_nor_trips_over_it(tmp_path):
    dataset = write_dataset(tmp_path / "dataset", n_pairs=1)
    run(dataset, tmp_path / "run")
    write_report(tmp_path / "run")
    before = shutil.copytree(tmp_path / "run", tmp_path / "before")
    outcome = run(dataset, tmp_path / "run")
    assert outcome.n_made == 0
    assert_same_tables(before, tmp_path / "run")
    assert (tmp_path / "run" / "report.html").exists()
    assert len(list((tmp_path / "run" / "figures").iterdir())) == 2 * len(FIGURES)


@pytest.mark.slow
def test_objects_carry_the_numbers_of_the_parquet(report_run, written):
    metrics = pd.read_parquet(report_run / "metrics").set_index(["pair_id", "real_id"])
    data = embedded(written.page.read_text("utf-8"))
    n = 0
    for pair, view in data["views"].items():
        for row in view["matched"]:
            values = dict(zip(data["matched_columns"], row, strict=True))
            stored = metrics.loc[(pair, values["real_id"])]
            for column in ("cdc", "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m"):
                assert values[column] == stored[column]
            n += 1
    assert n == len(metrics) > 0


def test_spectra_that_are_drawn_have_the_stored_largest_shift(report_run):
    results = read_results(report_run)
    n = 0
    for pair in results.select(None):
        rows = results.matched[results.matched.pair_id == pair].set_index("real_id")
        for real_id, spectra in PairTables(results, pair).spectra():
            assert spectra.reason == ""
            assert np.abs(spectra.sim - spectra.real).max() == pytest.approx(
                rows.max_eigenvalue_shift[real_id], abs=1e-9
            )
            assert len(spectra.real) == rows.n_keep[real_id]
            n += 1
    assert n == len(results.matched)


def test_every_object_is_counted_once_in_the_sentence(report_run):
    results = read_results(report_run)
    shares = [int(n) for n in re.findall(r"(\d+) %", verdict_of(results).sentence)]
    assert sum(shares) == pytest.approx(100, abs=3)
    objects = pd.read_parquet(report_run / "objects").query("side == 'real'")
    assert f"Of the {len(objects):,} real objects" in verdict_of(results).sentence


def test_six_numbers_are_the_means_of_pairs_parquet(report_run):
    pairs = pd.read_parquet(report_run / "pairs.parquet").query("status == 'scored'")
    numbers = {of["name"]: of for of in verdict_of(read_results(report_run)).numbers}
    assert len(numbers) == 6
    assert numbers["r_lambda"]["mean"] == pytest.approx(pairs.r_lambda_mean.mean())
    assert numbers["r_lambda"]["std"] == pytest.approx(pairs.r_lambda_mean.std(ddof=1))
    assert numbers["match rate"]["mean"] == pytest.approx(pairs.match_rate.mean())


def test_an_object_score_says_of_how_many_pairs_it_is_and_what_it_is_with_unmatched_as_worst(report_run, written):
    pairs = pd.read_parquet(report_run / "pairs.parquet").query("status == 'scored'")
    n_unmatched = pairs.n_missing + pairs.n_hallucinated
    worst = (pairs.cdc_mean.fillna(0) * pairs.n_matched + 2 * n_unmatched) / (pairs.n_matched + n_unmatched)
    numbers = {of["name"]: of["count"] for of in verdict_of(read_results(report_run)).numbers}
    assert (
        numbers["CDC"] == f"{pairs.cdc_mean.count()} of {len(pairs)} pairs; {worst.mean():.3f} with unmatched as worst"
    )
    assert numbers["match rate"] == numbers["missing objects"] == ""
    assert f"; {numbers['CDC']}</p>" in words(written.page)


def test_a_class_says_of_how_many_objects_a_mean_is_where_some_have_no_score(report_run):
    run = FinishedRun(report_run)
    first, *others = run.record.findings.classes
    fewer = first.model_copy(update={"r_lambda_n": first.n_matched - 1})
    findings = run.record.findings.model_copy(update={"classes": (fewer, *others)})
    console = Console(file=StringIO(), width=400)
    record = run.record.model_copy(update={"findings": findings})
    console.print(summary_view(report_run, run.rows, record, record.overview, with_all=True))
    assert f"{first.r_lambda_mean:.3f}*" in console.file.getvalue()
    assert f"{first.label} r_lambda of {first.n_matched - 1}" in console.file.getvalue()


def test_the_worst_stand_first_and_unmatched_objects_last(report_run):
    objects = page_data(read_results(report_run))["objects"]
    rows = pd.DataFrame(objects["rows"], columns=[column["key"] for column in objects["columns"]])
    matched = rows[rows.cdc.notna()]
    assert matched.index.tolist() == list(range(len(matched)))
    ranks = matched.cdc.rank() + matched.r_lambda.rank()
    assert ranks.is_monotonic_decreasing


@pytest.mark.slow
def test_identical_sides_are_faithful(tmp_path):
    for side in ("real", "sim"):
        write_bin(tmp_path / "dataset" / side / "a.bin", street())
    run(tmp_path / "dataset", tmp_path / "run")
    results = read_results(tmp_path / "run")
    assert set(results.matched.quadrant) == {"faithful"}
    assert results.matched.laplacian_change.max() <= IDENTICAL_CHANGE
    made = write_report(tmp_path / "run")
    assert "100 % faithfully" in words(made.page)


def test_thinning_leaves_no_object_out():
    community = np.repeat(np.arange(40), np.linspace(3, 4000, 40).astype(int))
    shown = np.bincount(community[thinned(community, 2000)], minlength=40)
    assert (shown >= np.minimum(80, np.bincount(community))).all()
    assert shown.sum() < 2000 + 40 * 80


def test_more_pairs_than_fit_leave_the_worst_the_middle_and_the_best():
    names = [f"{i:03}" for i in range(100)]
    shown = some_of(names, MOST_VIEWS)
    assert len(shown) == MOST_VIEWS
    assert shown[0] == "000"
    assert shown[-1] == "099"
    assert "050" in shown


def test_pairs_chooses_by_name_and_says_when_nothing_matches(report_run):
    results = read_results(report_run)
    assert results.select("x*") == ["x" * 300]
    with pytest.raises(RunError, match="matches none of the 4 scored pairs"):
        results.select("nothing*")


@pytest.mark.slow
def test_a_folder_that_is_no_run_is_refused(tmp_path):
    found = command("report", tmp_path)
    assert found.returncode == 1
    assert "a folder written by fidpipe run is wanted" in found.stderr


@pytest.mark.parametrize("gone", ["summary", "metrics"])
def test_a_run_that_has_not_ended_or_is_of_an_older_version_is_refused(copied_run, gone):
    record = json.loads((copied_run / "run.json").read_text())
    del record[gone]
    (copied_run / "run.json").write_text(json.dumps(record))
    with pytest.raises(RunError, match="has not ended"):
        read_results(copied_run)


def test_a_damaged_table_is_refused(copied_run):
    path = sorted((copied_run / "metrics").iterdir())[0]
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    os.utime(path, (1, 1))
    with pytest.raises(RunError, match="damaged or gone"):
        read_results(copied_run)


def test_a_run_without_a_scored_pair_is_refused(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / "dataset" / side).mkdir(parents=True)
        (tmp_path / "dataset" / side / "a.bin").write_bytes(b"")
    run(tmp_path / "dataset", tmp_path / "run")
    with pytest.raises(RunError, match="none of its 1 pairs is scored"):
        read_results(tmp_path / "run")


def test_signs_of_markup_are_escaped_in_the_embedded_data():
    page = render("compare.html", {"name": "</script><!--&"}, sections=[], method="")
    assert r"\u003c/script\u003e\u003c!--\u0026" in page
    assert embedded(page)["name"] == "</script><!--&"


def test_names_in_templates_are_escaped():
    assert "&lt;b&gt;&amp;" in render("compare.html", {}, sections=[], method="<b>&")


def test_a_damaged_table_of_points_is_refused_before_anything_is_written(copied_run):
    sorted((copied_run / "graph").iterdir())[0].unlink()
    with pytest.raises(RunError, match="damaged or gone"):
        write_report(copied_run)
    assert not (copied_run / "report.html").exists()


def test_charts_have_every_object_once_and_no_name_as_markup(report_run):
    results = read_results(report_run)
    charts = run_charts(results)
    opened = [(pair, name) for trace in charts["quadrants"]["data"] for pair, name in trace["customdata"]]
    scored = results.matched[results.matched.r_lambda.notna()]
    assert sorted(opened) == sorted((pair, f"real {i}") for pair, i in zip(scored.pair, scored.real_id, strict=True))
    bars = sum(sum(counted["counts"]) for counted in histograms(results).values())
    assert bars == len(scored) + results.matched.cdc.notna().sum()
    assert "<script>" not in json.dumps(charts)
    assert "<img" not in json.dumps(charts)


@pytest.mark.slow
def test_a_run_in_which_nothing_matches_has_a_report_without_the_figure_of_objects(tmp_path):
    dataset = write_dataset(tmp_path / "dataset", n_pairs=1, n=60)
    run(dataset, tmp_path / "run", load(None, ["matching.delta_m=0.001"]))
    made = write_report(tmp_path / "run")
    assert "100 % are missing" in words(made.page)
    assert {path.stem for path in made.figures} == FIGURES - {"objects"}


@pytest.mark.slow
def test_objects_without_a_score_are_in_no_quadrant(tmp_path):
    dataset = write_dataset(tmp_path / "dataset", n_pairs=1, n=60)
    run(dataset, tmp_path / "run", load(None, ["graph.edges=intersection", "graph.tau_m=0.01"]))
    results = read_results(tmp_path / "run")
    counted = histograms(results)["r_lambda"]
    assert counted["n"] == 0
    assert counted["n_null"] == len(results.matched) > 0
    assert quadrants(results)["no score"]["n"] == len(results.matched)
    assert "are too small to judge" in words(write_report(tmp_path / "run").page)
