"""Scores of a perfect simulator, and excess over them: by hand, resumed, rejected, and shown."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import wasserstein_distance

from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.generate.best_case_run import run_best_case
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.pipeline.report.views.best_case_view import excess_view
from fidpipe.pipeline.results.best_case import excess_over
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.metric_catalogue import OBJECT_METRICS, scores_of
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import Settings, load
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.sensor_description import describe_sensor
from reports import text_of
from runs import QUIET, assert_same_tables, command, listening
from scenes import drifted, rigid, street, write_bin, write_dataset

REFERENCE = load(preset="reference")


def best_case(dataset, out, reporter=QUIET, *, settings=None, **options):
    return run_best_case(
        dataset, out, settings or Settings(), reporter, machines=Machines(1), **options
    )


def shown(*words, code=0):
    return command(*words, code=code).stdout


@pytest.fixture(scope="module")
def folder(scenario):
    """Three streets, their run, and their best case."""
    return scenario("best_case")


def test_without_noise_and_dropout_it_is_exactly_perfect(folder, tmp_path):
    reporter, said = listening()
    made = best_case(
        folder / "streets",
        tmp_path / "best_case",
        reporter,
        settings=REFERENCE,
        noise_m=0.0,
        lost_share=0.0,
    )
    assert "warning" not in said.getvalue()
    for row in made.rows:
        assert row["match_rate"] == 1
        assert {row[f"{metric}_mean"] for metric in OBJECT_METRICS} == {0}
        assert {row[name] for name in scores_of("coverage")} == {1}


def test_noise_and_losses_are_those_of_each_scan_and_usual_ones_where_it_shows_none(
    folder, tmp_path
):
    rows = make_pair(0, 0, SENSORS["vlp16"], 12_000).real.rows
    for side in ("real", "sim"):
        write_bin(tmp_path / "data" / side / "cast.bin", rows[:, :3])
        write_bin(tmp_path / "data" / side / "street.bin", street())
    reporter, said = listening()
    made = best_case(tmp_path / "data", tmp_path / "best_case", reporter, settings=REFERENCE)
    own = describe_sensor(rows[:, :3].astype(np.float32).astype(float))
    text = said.getvalue()
    assert "1 of 2 real scans" in text and "--noise-m" in text
    again = read_scan(tmp_path / "best_case" / "dataset" / "sim" / "cast.parquet").points
    second = describe_sensor(again)
    assert own.lost_share > 0.1 and second.lost_share == pytest.approx(own.lost_share, abs=0.02)
    # it loses other pulses, but not more of them
    assert len(again) == pytest.approx(len(rows), rel=0.05)
    assert "lost returns" not in {cause.name for cause in made.record.overview.causes}


def test_it_is_resumed_and_made_again_only_where_the_real_scan_changed(folder, tmp_path):
    data = write_dataset(tmp_path / "streets", 3)
    out = tmp_path / "best_case"
    first = best_case(data, out, pattern="000")
    assert len(first.rows) == 1
    (out / "dataset" / "pairs.csv").unlink()  # as if it had been interrupted
    assert best_case(data, out).n_made
    assert_same_tables(out, folder / "best_case")
    made = {path.name: path.read_bytes() for path in (out / "dataset" / "sim").iterdir()}
    assert best_case(data, out).n_made == 0
    assert {
        path.name: path.read_bytes() for path in (out / "dataset" / "sim").iterdir()
    } == made
    write_bin(data / "real" / "001.bin", street(seed=77))
    assert best_case(data, out).n_made == first.n_made
    now = {path.name: path.read_bytes() for path in (out / "dataset" / "sim").iterdir()}
    assert {name for name in now if now[name] != made[name]} == {"001.parquet"}


def test_the_simulated_side_does_not_matter(folder, tmp_path):
    data = write_dataset(tmp_path / "streets", 3)
    (data / "sim" / "000.bin").write_bytes(b"")
    settings = load(assignments=["input.sim_frame=carla"])
    assert not best_case(data, tmp_path / "best_case", settings=settings).failures
    assert_same_tables(tmp_path / "best_case", folder / "best_case")


def test_a_pair_without_a_real_scan_fails_alone(tmp_path):
    data = write_dataset(tmp_path / "streets", 2)
    (data / "real" / "000.bin").unlink()
    made = best_case(data, tmp_path / "best_case")
    assert list(made.failures) == ["000"]
    assert [row["status"] for row in made.rows] == ["failed", "scored"]


def test_t_real_sim_does_not_move_it_and_labels_stay(tmp_path):
    scan = street()
    write_bin(tmp_path / "data" / "a.bin", scan)
    write_bin(tmp_path / "data" / "b.bin", drifted(scan))
    np.repeat(np.array([4, 7], dtype="<u4"), [len(scan) - 100, 100]).tofile(
        tmp_path / "data" / "a.label"
    )
    (tmp_path / "data" / "labels.toml").write_text('4 = "road"\n7 = "pole"\n')
    T = " ".join(map(str, rigid(30, [1, 2, 0]).ravel()))
    (tmp_path / "data" / "pairs.csv").write_text(
        f"pair_id,real,sim,timestamp_s,T_real_sim\nx y,a.bin,b.bin,5.5,{T}\n"
    )
    made = best_case(tmp_path / "data", tmp_path / "best_case", settings=REFERENCE)
    assert made.rows[0]["match_rate"] == 1
    assert made.record.frames == {}
    (pair,) = read_dataset(tmp_path / "best_case" / "dataset").pairs
    again = read_scan(pair.sim)
    assert (pair.pair_id, pair.timestamp_s, pair.T_real_sim) == ("x y", 5.5, None)
    np.testing.assert_array_equal(np.unique(again.labels), ["pole", "road"])
    assert (again.labels == "pole").sum() < 100


def test_a_finished_best_case_is_not_replaced_by_another_recipe_or_dataset(folder, tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    out = tmp_path / "best_case"
    n_made = best_case(data, out).n_made
    with pytest.raises(RunError, match="range noise 0.1 m.*--replace"):
        best_case(data, out, noise_m=0.1)
    with pytest.raises(RunError, match="graph.k was 90, is 20"):
        best_case(data, out, settings=load(assignments=["graph.k=20"]))
    with pytest.raises(RunError, match="of .*test_a_finished.*, of .*streets.*--replace"):
        best_case(folder / "streets", out)
    with pytest.raises(RunError, match="--out"):
        best_case(folder / "streets", folder / "run")
    # all but those of the real side
    assert best_case(data, out, noise_m=0.1, replace=True).n_made == n_made - 4


def test_excess_is_paired_by_name_and_areas_are_over_objects(folder):
    found = excess_over(FinishedRun(folder / "run"), folder / "best_case")
    run_pairs = pd.read_parquet(folder / "run" / "pairs.parquet")
    best_case_pairs = pd.read_parquet(folder / "best_case" / "pairs.parquet")
    best_case_pairs = best_case_pairs.set_index("pair_id").loc[::-1]
    for column in ("match_rate", "r_lambda_mean", "covered_real_0p3m"):
        over = (run_pairs.set_index("pair_id")[column] - best_case_pairs[column]).sort_index()
        own = found.scores[column]
        assert found.of_pairs[column].to_dict() == pytest.approx(over.to_dict())
        assert (own["excess"], own["std"]) == pytest.approx((over.mean(), over.std()))
        assert own["mean"] - own["best_case"] == pytest.approx(own["excess"])
    own = found.scores["cdc_mean"]
    values = pd.read_parquet(folder / "run" / "metrics").cdc.to_numpy()
    best_case_values = pd.read_parquet(folder / "best_case" / "metrics").cdc.to_numpy()
    assert own["bias"] == pytest.approx(values.mean() - best_case_values.mean())
    area = wasserstein_distance(values - own["bias"], best_case_values)
    assert own["area"] == pytest.approx(area)


def test_a_best_case_is_a_run_as_any_other_and_has_no_excess_over_itself(folder, tmp_path):
    assert set(run_status(folder / "best_case").stages["metrics"]) == {"done"}
    own = excess_over(FinishedRun(folder / "best_case"), folder / "best_case")
    assert {score["excess"] for score in own.scores.values()} - {None} == {0}
    shown("gate", folder / "best_case", "--max", "pairs.changed=0", "--out", tmp_path)


def test_a_best_case_is_titled_as_one_and_names_the_command_that_takes_it(folder):
    text = " ".join(shown("show", folder / "best_case").split())
    assert text.startswith("best case of streets: 3 pairs, preset paper ")
    assert text.endswith(f"Next fidpipe show RUN --best-case {folder}/best_case")


def test_a_wrong_best_case_is_refused_and_both_are_named(folder, tmp_path):
    finished = FinishedRun(folder / "run")
    with pytest.raises(RunError, match=r"run: is not a run of fidpipe best-case"):
        excess_over(finished, folder / "run")
    best_case(
        folder / "streets", tmp_path / "settings", settings=load(assignments=["graph.k=20"])
    )
    with pytest.raises(RunError, match="graph.k is 90 and 20"):
        excess_over(finished, tmp_path / "settings")
    best_case(write_dataset(tmp_path / "streets", 3, n=160), tmp_path / "scans")
    with pytest.raises(RunError, match="scans of 3 pairs differ"):
        excess_over(finished, tmp_path / "scans")


def test_pairs_without_a_best_case_are_left_out_and_named(folder, tmp_path):
    best_case(folder / "streets", tmp_path / "part", pattern="00[12]")
    found = excess_over(FinishedRun(folder / "run"), tmp_path / "part")
    assert (found.pairs, found.left_out) == (("001", "002"), ("000",))
    assert "1 pairs are not in the best case" in shown(
        "show", folder / "run", "--best-case", tmp_path / "part"
    )


def test_people_and_programs_see_the_same_excess(folder, tmp_path):
    own = excess_over(FinishedRun(folder / "run"), folder / "best_case").scores["cdc_mean"]
    words = ("show", folder / "run", "--best-case", folder / "best_case")
    assert f"{own['excess']:+.3f}" in shown(*words)
    assert json.loads(shown(*words, "--json"))["excess"]["scores"]["cdc_mean"] == own
    table = text_of(excess_view(excess_over(FinishedRun(folder / "run"), folder / "best_case")))
    assert {"extra", "objects"} <= {*table.split()} and "…" not in table, (
        "whole words in 80 columns"
    )
    page = write_report(
        folder / "run", out=tmp_path, best_case=folder / "best_case"
    ).page.read_text()
    assert "Over the best case" in page
    assert f"<td>{own['excess']:+.3f}</td>" in page
    assert (
        "Over the best case" not in write_report(folder / "run", out=tmp_path).page.read_text()
    )
    shown("show", folder / "run", "001", "--best-case", folder / "best_case", code=2)


def test_a_gate_judges_excess_and_wants_a_best_case_for_it(folder, tmp_path):
    found = excess_over(FinishedRun(folder / "run"), folder / "best_case")
    own = found.scores
    words = ("gate", folder / "run", "--out", tmp_path)
    with_best_case = (*words, "--best-case", folder / "best_case")
    limits = {
        "excess.cdc.mean": own["cdc_mean"]["excess"],
        "excess.r_lambda.max": float(found.of_pairs["r_lambda_mean"].max()),
        "excess.cdc.area": own["cdc_mean"]["area"],
        "excess.covered.real.0.3m.mean": own["covered_real_0p3m"]["excess"],
    }
    for measure, value in limits.items():
        shown(*with_best_case, "--max", f"{measure}={value + 1e-9!r}")
        shown(*with_best_case, "--max", f"{measure}={value - 1e-9!r}", code=4)
    refused = command(*words, "--max", "excess.cdc.mean=1", code=1)
    assert "'excess.cdc.mean': needs a best case; add --best-case RUN" in " ".join(
        refused.stderr.split()
    )


def test_the_command_takes_amounts_and_names_their_defaults(folder, tmp_path):
    words = (
        "best-case",
        folder / "streets",
        "--preset",
        "reference",
        "--workers",
        1,
        "--pairs",
        "000",
    )
    text = shown(*words, "--noise-m", 0, "--dropout", 0, "--out", tmp_path / "best_case")
    assert "preset reference" in text
    assert pd.read_parquet(tmp_path / "best_case" / "pairs.parquet").cdc_mean.tolist() == [0]
    help_text = " ".join(shown("best-case", "--help").replace("│", " ").split())
    for option in ("--noise-m", "--dropout"):
        assert "else as measured" in help_text.rpartition(option)[2]


def test_what_limits_trust_names_the_best_case_only_where_none_is_at_hand(folder):
    wanted = f"fidpipe best-case {folder / 'run'}"
    assert wanted in " ".join(shown("show", folder / "run", "--all").split())
    assert "fidpipe best-case" not in shown(
        "show", folder / "run", "--all", "--best-case", folder / "best_case"
    )
    assert "fidpipe best-case" not in shown("show", folder / "best_case", "--all")


def test_a_best_case_of_scans_in_another_frame_is_that_of_the_turned_ones(tmp_path):
    scan = street()
    for name, points in (("ros", scan), ("nuscenes", scan[:, [1, 0, 2]] * [-1, 1, 1])):
        for side in ("real", "sim"):
            write_bin(tmp_path / name / side / "a.bin", points)
    usual = best_case(tmp_path / "ros", tmp_path / "usual", settings=REFERENCE)
    own = load(preset="reference", assignments=["input.real_frame=nuscenes"])
    turned = best_case(tmp_path / "nuscenes", tmp_path / "turned", settings=own)
    assert turned.rows[0]["match_rate"] == 1
    assert turned.record.frames == {}
    assert turned.rows[0]["n_matched"] == usual.rows[0]["n_matched"]


def test_the_best_case_of_a_run_has_its_settings_and_lies_next_to_it(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    settings = ("--set", "graph.k=20")
    shown(
        "run",
        data,
        "--preset",
        "reference",
        *settings,
        "--workers",
        1,
        "--out",
        tmp_path / "run",
    )
    shown("best-case", tmp_path / "run", *settings, code=2)
    shown("best-case", tmp_path / "run", "--workers", 1)
    assert "Over the best case" not in shown("show", tmp_path / "run")
    assert "best case" in shown(
        "show", tmp_path / "run", "--best-case", tmp_path / "run-best-case"
    )
    found = FinishedRun(tmp_path / "run-best-case").record
    assert (found.preset, found.departures) == ("reference", ("graph.k=20",))


def test_every_next_step_has_the_preset_and_the_settings(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    text = " ".join(shown("check", data, "--set", "graph.k=20", code=None).split())
    assert f"fidpipe run {data} --preset reference --set graph.k=20" in text
    shown("run", data, "--set", "graph.k=20", "--workers", 1, "--out", tmp_path / "run")
    text = " ".join(shown("show", tmp_path / "run", "--all").split())
    assert (
        f"fidpipe run {data} --preset reference --set graph.k=20 --out runs/streets-reference"
        in text
    )
