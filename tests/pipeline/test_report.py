"""The report of a run: input that it reads or rejects, its content, and names that cannot break it."""

import html
import re
import shutil
from urllib.parse import parse_qs
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from fidpipe.pipeline.report.page.pair_data import pair_data, thinned
from fidpipe.pipeline.report.page.run_data import page_words
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.pipeline.report.run_frames import coordinates, points_of, read_results
from fidpipe.pipeline.report.views.run_view import dataset_table
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.settings import load
from fidpipe.stages.metrics import IDENTICAL_CHANGE
from reports import HOSTILE_CLASS, HOSTILE_PAIRS, embedded, points_in
from runs import assert_same_tables, command, run
from scenes import street, write_bin, write_dataset


@pytest.fixture
def copied_run(report_run, tmp_path):
    return shutil.copytree(report_run, tmp_path / "run")


@pytest.fixture(params=["report_run", "by_reference"])
def either_run(request):
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def results(report_run):
    return read_results(report_run)


@pytest.fixture(scope="session")
def written(report_run):
    """The folder of the report of that run; not to be written to."""
    return report_run.with_name("report")


def page_of(folder):
    return folder / "report.html"


def words_of(folder):
    """What the page of a run shows, without any pair in 3D."""
    return page_words(read_results(folder), ())


def words(page):
    """Text of a page without its scripts."""
    return page.read_text("utf-8").partition('<script type="application/json"')[0]


def test_the_papers_figures_are_written_as_png_svg_and_pdf_and_keep_other_files(
    report_run, tmp_path
):
    mine = tmp_path / "figures" / "mine.png"
    mine.parent.mkdir()
    mine.write_bytes(b"")
    files = write_report(report_run, out=tmp_path, with_figures=True)
    assert {path.stem for path in files.figures} >= {"r_lambda", "pieces", "scores", "objects"}
    assert set(mine.parent.iterdir()) == {*files.figures, mine}
    for path in files.figures:
        if path.suffix == ".png":
            assert np.asarray(Image.open(path).convert("L")).std() > 5, "an empty picture"
        elif path.suffix == ".pdf":
            assert path.read_bytes().startswith(b"%PDF-")
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_the_head_of_the_page_names_the_preset_and_what_departs_from_it(
    report_run, by_reference
):
    paper = words_of(report_run)["line"]
    reference = words_of(by_reference)["line"]
    assert paper.endswith("preset paper")
    assert reference.endswith("preset reference, but graph.k=20")


@pytest.mark.exhaustive
def test_open_asks_for_a_browser_and_says_where_the_page_is_if_there_is_none(
    copied_run, monkeypatch
):
    asked = []
    monkeypatch.setattr("webbrowser.open", lambda url: asked.append(url) or len(asked) == 1)
    found = [command("report", copied_run, *words) for words in (["--open"], ["--open"], [])]
    assert [one.returncode for one in found] == [0, 0, 0]
    assert asked == [(copied_run / "report.html").as_uri()] * 2
    assert "no browser could be started" not in found[0].stdout + found[0].stderr
    assert "no browser could be started" in found[1].stdout + found[1].stderr


def test_no_name_ends_a_script_or_opens_a_tag(written):
    text = page_of(written).read_text("utf-8")
    assert "alert(1)" in text, "the names are there"
    assert "<script>alert" not in text
    assert "<img src=x" not in text
    data = embedded(page_of(written).read_text("utf-8"))
    assert sorted(data["names"]) == sorted(HOSTILE_PAIRS)
    assert html.escape(HOSTILE_CLASS) in text


def test_the_page_asks_for_nothing_from_elsewhere(written):
    assert "default-src 'none'" in words(page_of(written)).partition("<body>")[0]
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", words(page_of(written)))


def test_a_run_after_a_report_neither_removes_nor_trips_over_it(
    copied_run, report_run, written
):
    shutil.copytree(written, copied_run, dirs_exist_ok=True)
    assert run(report_run.with_name("streets"), copied_run).n_made == 0
    assert_same_tables(copied_run, report_run)
    assert (copied_run / "report.html").exists()


def test_the_first_screen_begins_with_surface_and_pieces(report_run, written):
    pairs = pd.read_parquet(report_run / "pairs.parquet").query("status == 'scored'")
    (answers,) = words_of(report_run)["answer"]
    sections = dict(answers.sections)
    assert [*sections][:2] == ["  surface", "  pieces"]
    real = 100 * pairs.covered_real_0p3m.mean()
    sim = 100 * pairs.covered_sim_0p3m.mean()
    assert sections["  surface"][0][0].startswith(
        f"{real:.0f} % of the real surface is simulated within 0.3 m, {sim:.0f} % of the"
    )
    counts = [pairs[f"n_{kind}_pieces"].mean() for kind in ("missing", "invented")]
    assert sections["  pieces"][0][0] == "{:.1f} missing and {:.1f} invented per pair".format(
        *counts
    )
    page = words(page_of(written))
    for cause_words, amount, setting in sections["Fix first"]:
        assert cause_words in page
        assert amount in page
        assert setting in page


def test_scores_are_means_of_pairs_parquet_with_the_papers_only_under_its_preset(
    either_run, report_run
):
    pairs = pd.read_parquet(either_run / "pairs.parquet").query("status == 'scored'")
    scores = dataset_table(FinishedRun(either_run).record)
    rows = {row[0]: dict(zip(scores.headings, row, strict=True)) for row in scores.cells}
    assert rows["r_lambda"]["mean"] == f"{pairs.r_lambda_mean.mean():.3f}"
    assert rows["r_lambda"]["std"] == f"{pairs.r_lambda_mean.std(ddof=1):.3f}"
    assert rows["found"]["mean"] == f"{pairs.found.mean():.3f}"
    ((line, *_),) = dict(words_of(either_run)["answer"][-1].sections)["Objects"]
    assert ("(paper 0.75)" in line) == (either_run == report_run)


def test_object_scores_say_of_how_many_pairs_they_are_and_their_value_with_unmatched_as_worst(
    report_run, results, written
):
    pairs = pd.read_parquet(report_run / "pairs.parquet").query("status == 'scored'")
    n_unmatched = pairs.n_not_found + pairs.n_extra
    worst = (pairs.cdc_mean.fillna(0) * pairs.n_matched + 2 * n_unmatched) / (
        pairs.n_matched + n_unmatched
    )
    scores = dataset_table(results.run.record)
    of = {row[0]: dict(zip(scores.headings, row, strict=True)) for row in scores.cells}
    assert of["CDC"]["pairs"] == f"{pairs.cdc_mean.count()} of {len(pairs)}"
    assert of["CDC"]["unmatched\nas worst"] == f"{worst.mean():.3f}"
    assert of["match rate"]["unmatched\nas worst"] == ""
    assert f"<td>{worst.mean():.3f}</td>" in page_of(written).read_text("utf-8")


def test_the_largest_pieces_lead_into_the_3d_view(by_reference, tmp_path):
    pieces = FinishedRun(by_reference).record.overview.pieces
    page = write_report(by_reference, out=tmp_path).page.read_text("utf-8")
    worst = words_of(by_reference)["worst"]
    assert [piece for _, piece in worst] == list(pieces)
    objects = pd.read_parquet(by_reference / "objects").set_index(
        ["pair_id", "side", "community_id"]
    )
    for link, piece in worst:
        asked = parse_qs(link.removeprefix("#"))
        assert asked["pair"] == [piece.pair_id]
        side, number = asked["object"][0].split()
        assert objects.n_points[piece.pair_id, side, int(number)] > 0
        assert (side, html.escape(link) in page, piece.words in page) == (
            piece.side,
            True,
            True,
        )


def test_points_that_belong_to_no_object_are_left_out_of_the_page(by_reference):
    results = read_results(by_reference)
    points = points_of(results.run, "0")["real"]
    is_first = points.community_id == 0
    points.loc[is_first, "community_id"] = -1
    counted = pair_data(results, "0")["sides"]["real"]
    assert 0 not in counted["ids"]
    assert counted["n"] == (points.community_id >= 0).sum()


def test_the_worst_stand_first_and_unmatched_objects_last(report_run):
    objects = words_of(report_run)["objects"]
    rows = pd.DataFrame(objects.rows, columns=objects.headings).rename(columns={"CDC": "cdc"})
    matched = rows[rows.cdc.notna()]
    assert matched.index.tolist() == list(range(len(matched)))
    ranks = matched.cdc.rank() + matched.r_lambda.rank()
    assert ranks.is_monotonic_decreasing


def test_identical_sides_are_faithful(tmp_path):
    for side in ("real", "sim"):
        write_bin(tmp_path / "dataset" / side / "a.bin", street())
    run(tmp_path / "dataset", tmp_path / "run")
    results = read_results(tmp_path / "run")
    assert set(results.matched.quadrant) == {"faithful"}
    assert results.matched.laplacian_change.max() <= IDENTICAL_CHANGE
    made = write_report(tmp_path / "run")
    page = words(made.page)
    assert "100 % of the real surface is simulated within 0.3 m" in page
    assert "no cause is larger than the differences between two measurements" in page
    assert "No piece of surface is missing or invented" in page


def test_pairs_chooses_by_name_and_says_when_nothing_matches(report_run, tmp_path):
    page = write_report(report_run, "x*", out=tmp_path).page.read_text("utf-8")
    assert [*embedded(page)["views"]] == ["x" * 300]
    with pytest.raises(RunError, match="matches none of the 4 scored pairs"):
        write_report(report_run, "nothing*", out=tmp_path)


def test_a_page_shows_the_worst_pairs_and_those_of_the_largest_pieces(
    report_run, tmp_path, monkeypatch
):
    monkeypatch.setattr("fidpipe.pipeline.report.page.run_page.MOST_VIEWS", 1)
    results = read_results(report_run)
    of_worst = {piece.pair_id for piece in results.run.overview.pieces}
    page = write_report(report_run, out=tmp_path).page.read_text("utf-8")
    assert set(embedded(page)["views"]) == {results.pairs.pair_id[0], *of_worst}


def test_a_run_without_a_scored_pair_is_refused(tmp_path):
    for side in ("real", "sim"):
        (tmp_path / "dataset" / side).mkdir(parents=True)
        (tmp_path / "dataset" / side / "a.bin").write_bytes(b"")
    run(tmp_path / "dataset", tmp_path / "run")
    with pytest.raises(RunError, match="no pair is scored; fidpipe status"):
        read_results(tmp_path / "run")


def test_a_damaged_table_of_points_is_refused_before_anything_is_written(copied_run):
    sorted((copied_run / "ground").iterdir())[0].unlink()
    with pytest.raises(RunError, match="damaged or gone"):
        write_report(copied_run)
    assert not (copied_run / "report.html").exists()


def test_a_run_in_which_nothing_matches_has_a_report_and_figures(tmp_path):
    dataset = write_dataset(tmp_path / "dataset", n_pairs=1, n=60)
    run(dataset, tmp_path / "run", load(None, ["matching.delta_m=0.001"]))
    made = write_report(tmp_path / "run", with_figures=True)
    assert made.figures
    assert "preset paper" in words(made.page).lower()


def test_objects_without_a_score_are_in_no_quadrant(tmp_path):
    dataset = write_dataset(tmp_path / "dataset", n_pairs=1, n=60)
    run(dataset, tmp_path / "run", load(None, ["graph.edges=intersection", "graph.tau_m=0.01"]))
    results = read_results(tmp_path / "run")
    assert set(results.matched.quadrant) == {"no score"}
    assert page_words(results, ())["bars"][2]["value"] == "0 % faithful"
    means = {row[0]: row[1] for row in dataset_table(results.run.record).cells}
    assert means["r_lambda"] == "-" != means["CDC"]
    assert write_report(tmp_path / "run").page.exists()


def test_a_page_has_every_point_of_every_object_and_no_other(either_run):
    results = read_results(either_run)
    for pair_id in results.pairs.pair_id:
        view = pair_data(results, pair_id)
        for side, points in points_of(results.run, pair_id).items():
            objects = points[~points.is_ground]
            road = coordinates(points[points.is_ground])
            counted = view["sides"][side]
            shown = points_in(view, side)
            assert counted["n"] == len(objects) == len(shown)
            distance_m, nearest = cKDTree(coordinates(objects)).query(shown)
            assert distance_m.max() <= np.sqrt(3) / 2 * view["step_m"] + 1e-9
            assert sorted(nearest) == list(range(len(shown)))
            assert (
                np.repeat(counted["ids"], counted["counts"]).tolist()
                == objects.community_id.iloc[nearest].tolist()
            )
            of_page = points_in(view, side, "road")
            assert 0 < len(of_page) <= len(road)
            assert (
                cKDTree(road).query(of_page)[0].max() <= np.sqrt(3) / 2 * view["step_m"] + 1e-9
            )


def test_thinning_leaves_no_object_out():
    community = pd.Series(np.repeat(np.arange(40), np.linspace(3, 4000, 40).astype(int)))
    shown = np.bincount(community[thinned(community, 2000)], minlength=40)
    assert (shown >= np.minimum(80, np.bincount(community))).all()
    assert shown.sum() < 2000 + 40 * 80
    assert thinned(community, len(community)).all()
