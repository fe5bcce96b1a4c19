"""Overview and findings of a run against its tables, its last lines, and its line on the run that it replaced."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline import run as run_module
from fidpipe.pipeline.report.views.run_view import outcome_view, summary_view
from fidpipe.pipeline.report.views.show_view import show_view
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.overview import BAD_ALIGNMENT_M, describe_objects, largest_pieces
from fidpipe.schemas.settings import MatchingSettings
from fidpipe.stages.statistics.bands import BAND_EDGES_M, BAND_NAMES
from reports import text_of
from runs import command, run
from scenes import drifted, street, write_bin, write_dataset, write_pair

NUSCENES = [
    f"n008-2018-08-01-15-16-36-0400__LIDAR_TOP__15331516{i}7909" for i in (3597, 3647, 3697)
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Three labelled pairs with long names, over a minute apart; dataset, run and outcome."""
    folder = tmp_path_factory.mktemp("overview")
    manifest = "pair_id,real,sim,timestamp_s\n"
    for i, name in enumerate(NUSCENES):
        scan = street(i)
        sim = drifted(scan, noise=0.3, keep=0.4)
        write_pair(
            folder / "streets",
            scan,
            sim,
            name,
            lambda points: np.arange(len(points)) * 7 // 100 % 3 + 1,
        )
        manifest += f"{name},real/{name}.bin,sim/{name}.bin,{100 * i}\n"
    (folder / "streets" / "pairs.csv").write_text(manifest)
    long = "movable_object.pushable_pullable_and_more_words_than_fit"
    (folder / "streets" / "labels.toml").write_text(
        f'1 = "{long}.a"\n2 = "{long}.b"\n3 = "car"\n'
    )
    return folder / "streets", folder / "run", run(folder / "streets", folder / "run")


def test_nodes_are_badly_aligned_where_centroids_would_not_match():
    assert MatchingSettings().delta_m == BAD_ALIGNMENT_M


def test_the_overview_of_the_record_is_that_of_the_tables(finished):
    _, folder, outcome = finished
    overview = outcome.record.overview
    objects, coverage = (
        pd.read_parquet(folder / "objects"),
        pd.read_parquet(folder / "coverage"),
    )
    both = objects.merge(
        coverage.dropna(subset="community_id"), on=["pair_id", "side", "community_id"]
    )
    pieces = pd.read_parquet(folder / "pieces")
    both["band"] = np.array(BAND_NAMES)[np.digitize(both.range_m, BAND_EDGES_M) - 1]
    groups = outcome.record.findings.groups
    for one in groups:
        for side, n, share in (
            ("real", one.n_real_points, one.missing_share),
            ("sim", one.n_sim_points, one.invented_share),
        ):
            own = both[
                (both.side == side)
                & (both["label" if one.by == "class" else "band"] == one.name)
            ]
            assert n == own.n_points_x.sum()
            expected = (own.n_points_x * (1 - own.covered_0p3m)).sum() / n if n else None
            assert share == (None if expected is None else pytest.approx(expected))
    assert {one.name for one in groups if one.by == "class"} == set(objects.label.dropna())
    assert [one.n_points for one in overview.pieces] == pieces.n_points.nlargest(
        len(overview.pieces)
    ).tolist()


def test_the_overview_read_again_is_the_one_written(finished):
    _, folder, outcome = finished
    again = FinishedRun(folder)
    assert again.record.overview == outcome.record.overview
    pairs = outcome.pairs
    times = {name: 100.0 * i for i, name in enumerate(NUSCENES)}
    findings, found = describe_objects(
        again.store, pairs, times, again.record.inputs, by_reference=False
    )
    assert findings == again.record.findings
    assert found.as_dict() == {
        name: value
        for name, value in again.record.overview.as_dict().items()
        if name != "trust"
    }


def test_the_largest_pieces_are_named_by_size_place_and_fate_and_one_that_moved_once():
    place = {
        "range_m": 7.2,
        "bearing_deg": 40.0,
        "extent_x": 4.2,
        "extent_y": 1.8,
        "extent_z": 1.5,
    }
    moved = {f"moved_{axis}_m": 0.5 * (axis == "y") for axis in "xyz"}
    rows = [
        ("real", 0, 90, "gone", None),
        ("sim", 2, 10, "gone", None),
        ("sim", 0, 500, "gone", "car"),
    ]
    rows += [("real", 1, 300, "moved", None), ("sim", 1, 310, "moved", None)]
    names = ("side", "piece_id", "n_points", "fate", "label")
    pieces = pd.DataFrame([dict(zip(names, row, strict=True)) | place | moved for row in rows])
    pieces["pair_id"] = [*"aabbb"]
    store = SimpleNamespace(read_pairs=lambda *_: {("pieces", ""): pieces})
    assert [
        (one.pair_id, one.fate_words, one.words.split(", ")[0])
        for one in largest_pieces(store, ["a", "b"])
    ] == [
        ("b", "invented", "car"),
        ("b", "moved by 0.5 m to the left", "car-sized"),
        ("a", "missing", "car-sized"),
        ("a", "invented", "car-sized"),
    ]


def test_a_run_ends_with_surface_pieces_causes_places_scores_trust_and_the_next_step(finished):
    _, folder, outcome = finished
    lines = text_of(outcome_view(outcome), 200).splitlines()
    assert lines[0].startswith("streets: 3 pairs in ")
    assert lines[0].endswith(" s, preset paper")
    headings = [line[:14].strip() for line in lines[1:] if line[:14].strip()]
    assert headings == [
        "surface",
        "pieces",
        "Fix first",
        "Worst places",
        "Objects",
        "Trust",
        "Next",
    ]
    assert [line[14:] for line in lines[-3:]] == [
        f"fidpipe diagnose {folder}",
        f"fidpipe report {folder} --open",
        f"fidpipe best-case {folder}",
    ]
    assert len(lines) <= 24
    text = "\n".join(lines)
    assert "faithful" not in text
    assert "r_lambda" in text
    assert "(paper 0.37)" in text, "under preset paper"
    assert "3 pairs of 3 places: a verdict on the world needs 6 places" in text
    assert (
        "3 pairs, preset paper"
        in text_of(show_view(FinishedRun(folder), None, None)).splitlines()[0]
    )


@pytest.mark.parametrize("name", [None, NUSCENES[0]])
def test_no_line_is_wider_than_80_columns_with_long_names_and_labels(finished, name):
    run_ = FinishedRun(finished[1])
    for with_all in (False, True):
        shown = text_of(show_view(run_, name, None, with_all=with_all))
        assert max(map(len, shown.splitlines())) <= 80
        assert "…" in shown, "some name was shortened"
    if name is None:
        first = [line.split()[0] for line in shown.splitlines() if line.startswith(" n008")]
        assert len(set(first)) == 3, "shortened names can be told apart"
        assert all(
            line.rstrip()[-1].isdigit()
            for line in shown.splitlines()
            if line.startswith(" n008")
        ), "in a line"


@pytest.fixture(scope="module")
def by_command(finished, tmp_path_factory):
    out = tmp_path_factory.mktemp("json") / "run"
    return command("run", finished[0], "--out", out, "--workers", 1, "--json", code=0), out


def test_run_as_json_is_json_alone_and_what_show_gives(by_command):
    done, out = by_command
    found = json.loads(done.stdout)
    assert found["jobs"]["made"] > 0
    assert found["failures"] == {}
    shown = json.loads(command("show", out, "--json").stdout)
    assert {name: found[name] for name in shown} == shown


def test_check_as_json_names_each_scan_and_fault(finished, tmp_path):
    data = shutil.copytree(finished[0], tmp_path / "streets")
    (data / "sim" / f"{NUSCENES[1]}.bin").write_bytes(b"")
    found = json.loads(command("check", data, "--json", code=1).stdout)
    assert [pair["pair_id"] for pair in found["pairs"]] == NUSCENES
    assert found["pairs"][0]["real"]["n_clean"] > 0
    assert "empty" in found["pairs"][1]["sim"]["fault"]
    assert any("empty" in fault for fault in found["faults"])
    assert set(found["sensors"]) == {"real", "sim"}


def test_show_prints_the_summary_and_a_pair(by_command):
    _, out = by_command
    text = command("show", out).stdout
    assert text.startswith("streets: 3 pairs, preset paper")
    assert "\n  surface " in text
    assert NUSCENES[0] in command("show", out, NUSCENES[0]).stdout


def test_status_answers_in_ten_lines(by_command):
    shown = command("status", by_command[1]).stdout
    assert len(shown.splitlines()) <= 10
    assert "finished for all pairs: ground, sensor, graph" in shown


def test_the_findings_agree_with_the_tables(finished):
    _, folder, _ = finished
    found = json.loads((folder / "run.json").read_text())["findings"]
    objects = pd.read_parquet(folder / "objects")
    matching = pd.read_parquet(folder / "matching")
    for side, what in (("real", "not_found"), ("sim", "extra")):
        for by in ("range", "class"):
            groups = [group for group in found["groups"] if group["by"] == by]
            assert sum(group[f"n_{side}"] for group in groups) == (objects.side == side).sum()
            assert (
                sum(group[f"n_{what}"] for group in groups) == (matching.status == what).sum()
            )


def test_a_run_with_nothing_new_reads_no_table_again(finished, monkeypatch):
    data, folder, outcome = finished
    monkeypatch.setattr(
        run_module, "describe_objects", lambda *_, **__: pytest.fail("the tables were read")
    )
    assert (
        run(data, folder).record.as_dict()["findings"] == outcome.record.as_dict()["findings"]
    )


def test_other_timestamps_make_other_findings(finished):
    data, folder, before = finished
    manifest = (data / "pairs.csv").read_text()
    try:
        (data / "pairs.csv").write_text(manifest.replace(",200", ",105"))
        after = run(data, folder)
        assert after.n_made == 0
        assert (before.record.findings.n_places, after.record.findings.n_places) == (3, 2)
    finally:
        (data / "pairs.csv").write_text(manifest)
    assert run(data, folder).record.as_dict()["findings"] == before.record.as_dict()["findings"]


def test_copies_of_a_pair_count_once(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    once = run(data, tmp_path / "once")
    for side in ("real", "sim"):
        for name in ("copy", "another"):
            shutil.copy(data / side / "000.bin", data / side / f"{name}.bin")
    copied = run(data, tmp_path / "copied")
    assert copied.record.findings.n_places == once.record.findings.n_places == 1
    cautions = [caution.words for caution in copied.record.overview.trust]
    assert (
        "3 neighbouring frames of one place: a verdict on the world needs 6 places" in cautions
    )


def test_a_pair_without_a_match_is_counted_beside_the_means_and_is_the_worst(tmp_path):
    data = write_dataset(tmp_path / "streets", 2)
    write_bin(data / "sim" / "001.bin", street() + [60, 0, 0])
    outcome = run(data, tmp_path / "run")
    summary, n_scored = outcome.record.summary, outcome.record.pairs.scored
    assert (summary["cdc_mean"].n_pairs, summary["match_rate"].n_pairs) == (
        n_scored - 1,
        n_scored,
    )
    assert summary["cdc_unmatched_worst_mean"].n_pairs == n_scored
    view = summary_view(FinishedRun(outcome.folder), with_all=True)
    line = next(
        line for line in text_of(view, 300).splitlines() if line.strip().startswith("CDC  ")
    )
    assert f"{n_scored - 1} of {n_scored} " in line
    assert f"{summary['cdc_unmatched_worst_mean'].mean:.3f}" in line
