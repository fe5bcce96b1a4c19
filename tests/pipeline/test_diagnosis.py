"""`fidpipe diagnose`: a known flaw is the first cause everywhere; with --tell-apart, on runs and on folders."""

import json
import shutil

import numpy as np
import pytest

from fidpipe.pipeline.diagnose import tell_apart
from fidpipe.pipeline.diagnose.diagnose import diagnose_run
from fidpipe.pipeline.diagnose.diagnosis_view import diagnosis_view
from fidpipe.pipeline.diagnose.latency import follow, latency_words, speed_m_s
from fidpipe.pipeline.report.page.run_data import page_data
from fidpipe.pipeline.report.run_frames import read_results
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.diagnosis import DIAGNOSIS, interval_words
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.results import Diagnosis
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import load
from fidpipe.stages.diagnose import tell_apart as classifier
from fidpipe.stages.diagnose.evidence import PairScans, Side
from fidpipe.stages.diagnose.gain import Shares
from fidpipe.stages.displacement import PARAMETERS
from fidpipe.stages.generate.ray_casting import fire
from runs import command, run
from scenes import write_bin

TOO_LOW_M, TOO_LONG_M = 0.15, 0.1


def corner(seed):
    """A road between two walls with a box, sampled at random."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-15, 15, (2, 2500))
    z = rng.uniform(-1.5, 2, 2500)
    road = np.column_stack([x, y / 3, np.full(2500, -1.5)])
    walls = np.column_stack([x, np.where(y > 0, 5.0, -5.0), z])[:1500]
    end = np.column_stack([np.full(1500, 12.0), y[:1500] / 3, z[:1500]])
    return np.vstack([road, walls, end])


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory):
    """Runs of a simulator as it should be, of one that is mounted too high, and of one whose ranges are too long."""
    folder = tmp_path_factory.mktemp("diagnose")
    for name, low_m, longer_m in (("good", 0.0, 0.0), ("low", TOO_LOW_M, 0.0), ("long", 0.0, TOO_LONG_M)):
        for i in range(3):
            write_bin(folder / name / "real" / f"{i}.bin", corner(i))
            sim = corner(i + 10) - [0, 0, low_m]
            sim *= 1 + longer_m / np.linalg.norm(sim, axis=1, keepdims=True)
            write_bin(folder / name / "sim" / f"{i}.bin", sim)
        run(folder / name, folder / f"run-{name}", load(None, ["graph.k=10"], preset="reference"))
    return folder


@pytest.fixture
def runs(two_runs, tmp_path):
    return [shutil.copytree(two_runs / f"run-{name}", tmp_path / name) for name in ("good", "low")]


def test_the_flaw_is_the_first_cause_everywhere(runs):
    good, low = runs
    shown = command("diagnose", low, "--floor", good, "--json", code=0)
    found = Diagnosis.from_dict(json.loads(shown.stdout))
    first = found.causes[0]
    assert first.name == "height"
    assert first.estimate == pytest.approx(-TOO_LOW_M, abs=0.02)
    assert first.low < first.estimate < first.high
    assert 0.8 < first.gain <= 1.05
    assert found.unexplained < 0.2
    curves = first.evidence
    peaks = {name: curves.x[int(np.argmax(getattr(curves, name)))] for name in ("sim", "corrected")}
    assert peaks["sim"] == pytest.approx(-TOO_LOW_M, abs=0.02), "the road lies behind the real one"
    assert peaks["corrected"] == pytest.approx(0.0, abs=0.02)
    chart = page_data(read_results(low))["charts"]["cause_height"]
    assert [curve["name"] for curve in chart["data"]] == ["simulated", "corrected"]
    assert json.loads((low / DIAGNOSIS).read_text()) == json.loads(shown.stdout)
    assert not interval_words(first).startswith("-"), "of the size that the sentence names"
    summary = " ".join(command("show", low).stdout.split())
    assert f"changes against {good}" in summary
    assert "world 15 cm too low" in summary
    assert "no floor yet" not in summary
    assert "world 15 cm too low" in command("diagnose", low, "--floor", good, "--markdown").stdout
    assert "height" not in {cause.name for cause in diagnose_run(good).causes}
    changes = compare_runs([good, low], independent=True)[0].causes
    assert changes[0].name == "height"


def test_what_moved_is_measured_between_the_simulated_scans(two_runs):
    good, low, long = (two_runs / f"run-{name}" for name in ("good", "low", "long"))
    for other, name, amount_m in ((low, "height", -TOO_LOW_M), (long, "range bias", TOO_LONG_M)):
        found = {own.name: own.difference for own in compare_runs([good, other])[0].causes}
        assert found.keys() & set(PARAMETERS) == {name}
        assert found[name].difference == pytest.approx(amount_m, abs=0.01)
    diagnosed = diagnose_run(long, good)
    assert diagnosed.causes[0].name == "range bias"
    assert diagnosed.causes[0].estimate == pytest.approx(TOO_LONG_M, abs=0.01)


def test_what_no_correction_removes_is_the_first_cause_and_unsupported_causes_are_left_out(runs, monkeypatch):
    good, low = runs
    monkeypatch.setattr(
        "fidpipe.pipeline.diagnose.diagnose.shares",
        lambda scans, made, rng, floor_m: Shares(0.3, 0.3, floor_m, dict.fromkeys(made, 0.0)),
    )
    found = diagnose_run(low, good)
    assert [(cause.name, cause.unit) for cause in found.causes] == [("unexplained", "share")]
    assert 0.2 < found.causes[0].estimate < 0.6
    assert found.unexplained == 1
    assert "world 15 cm too low" in found.doubtful
    found = diagnose_run(low)
    assert [cause.name for cause in found.causes] == ["unexplained"]
    assert found.causes[0].estimate == pytest.approx(0.3)
    assert "100 % of the distance" in command("show", low).stdout
    assert "--floor" in FinishedRun(low).overview.causes[0].words
    bounded = found.causes[0].model_copy(update={"is_upper_bound": True})
    for causes, words in ((found.causes, "unexplained: 100 %"), ((bounded,), "unexplained: at least 100 %")):
        view = diagnosis_view(found.model_copy(update={"causes": causes}))
        assert any(getattr(own, "text", "").startswith(words) for own in view), view
    stored = json.loads((low / DIAGNOSIS).read_text())
    stored["causes"].append(stored["causes"][0] | {"name": "height"})
    (low / DIAGNOSIS).write_text(json.dumps(stored))
    names = [cause.name for cause in FinishedRun(low).overview.causes[:2]]
    assert names == ["height", "unexplained"], "what can be fixed comes first"


def test_surface_that_is_elsewhere_than_in_the_floor_is_the_first_cause(runs, monkeypatch):
    good, low = runs
    monkeypatch.setattr("fidpipe.pipeline.diagnose.diagnose.off_shares", lambda *of: (0.2, 0.15))
    found = diagnose_run(low, good)
    first, second, *_ = found.causes
    note = "no. 1 is a share of the surface"
    assert any(note in getattr(own, "text", "") for own in diagnosis_view(found))
    assert (first.name, first.unit, first.estimate) == ("unexplained", "share", pytest.approx(0.15))
    assert first.words.startswith("15 % of the flat surface")
    assert second.name == "height"
    monkeypatch.undo()
    found = diagnose_run(low, good)
    assert found.causes[0].name == "height"
    assert not any(note in getattr(own, "text", "") for own in diagnosis_view(found))


def test_a_diagnosis_of_other_results_is_not_used(runs):
    good, low = runs
    diagnose_run(low, good)
    assert FinishedRun(low).overview.causes[0].detail.startswith("gain")
    stored = json.loads((low / DIAGNOSIS).read_text())
    (low / DIAGNOSIS).write_text(json.dumps(stored | {"of": "another run"}))
    assert FinishedRun(low).overview == FinishedRun(low).record.overview


def test_a_part_of_the_pairs_is_diagnosed_but_not_stored(runs):
    _, low = runs
    assert diagnose_run(low, pattern="1").n_pairs == 1
    assert not (low / DIAGNOSIS).exists()


def test_a_floor_of_other_pairs_is_rejected(runs, scenario):
    with pytest.raises(RunError, match="labelled"):
        diagnose_run(runs[0], scenario("labelled") / "run")


SPEEDS_M_S = np.array([2.0, 5.0, 8.0, 11.0, 14.0])
ERRORS_M = np.array([0.01, -0.01, 0.0, 0.01, -0.01])


@pytest.mark.parametrize(
    ("ahead_m", "speeds_m_s", "words", "setting"),
    [
        (0.05 * SPEEDS_M_S + ERRORS_M, SPEEDS_M_S, "in proportion to the speed: 4", "poses and time stamps"),
        (0.4 + ERRORS_M, SPEEDS_M_S, "at any speed, so no latency", "position of the sensor, T_real_sim"),
        (0.4 + ERRORS_M, np.full(5, 8.0), "or 50 ms of latency at 8 m/s", "position of the sensor, or time stamps"),
        (
            0.2 + 0.05 * SPEEDS_M_S + ERRORS_M,
            SPEEDS_M_S,
            "partly in proportion to the speed: 4",
            "poses and time stamps; position of the sensor",
        ),
    ],
)
def test_latency_and_mounting_are_distinguished_by_the_speeds(ahead_m, speeds_m_s, words, setting):
    found = latency_words(ahead_m, speeds_m_s)
    assert found[0].startswith(words)
    assert found[1] == setting


def test_without_speeds_nothing_is_said_of_latency():
    assert latency_words(np.full(5, 0.4), np.full(5, np.nan)) is None
    assert latency_words(np.full(5, 0.4), np.zeros(5)) is None, "at rest"


@pytest.mark.parametrize("travel_m", [0.4, 2.9])
def test_the_speed_is_that_of_the_motion_to_the_next_scan(travel_m):
    scans, later = (
        PairScans(*[Side(points, points[:, 2] < -1.4, {})] * 2) for points in (corner(0), corner(1) - [travel_m, 0, 0])
    )
    assert speed_m_s(scans, later, 0.1) == pytest.approx(10 * travel_m, abs=0.5)


def test_the_next_scan_is_at_most_half_a_second_later():
    times_s = {"a": 0.0, "c": 0.5, "b": 0.2, "far": 9.0}
    following = follow(times_s, ["a", "b", "c", "far", "unknown"])
    rounded = {name: (later, round(duration_s, 3)) for name, (later, duration_s) in following.items()}
    assert rounded == {"a": ("b", 0.2), "b": ("c", 0.3)}


def room(rng, low_m=(-18.0, -12.0, -1.8), high_m=(31.0, 9.0, 6.0)):
    """Returns of a VLP-16 in a room, with 5 mm of noise."""
    directions = fire(SENSORS["vlp16"], step_deg=0.4).directions()
    range_m = (np.where(directions > 0, high_m, low_m) / np.where(directions == 0, 1e-9, directions)).min(axis=1)
    return directions * (range_m + rng.normal(0, 0.005, len(range_m)))[:, None]


def test_the_scale_of_the_intensity_is_a_cause_over_a_floor_or_with_one_scale(tmp_path):
    rng = np.random.default_rng(7)
    for i in range(3):
        sides = [room(rng) for _ in range(2)]
        for name, scale in (("good", 1.0), ("bright", 1.3)):
            for side, points in zip(("real", "sim"), sides, strict=True):
                intensity = (20 + 10 * (points[:, 1] > 0)) * (scale if side == "sim" else 1.0)
                write_bin(tmp_path / name / side / f"{i}.bin", np.column_stack([points, intensity]))
    for name in ("good", "bright"):
        run(tmp_path / name, tmp_path / f"run-{name}", load(None, ["graph.k=10"], preset="reference"))
    one_scale = load(None, ["graph.k=10", "input.intensity_scale=same"], preset="reference")
    run(tmp_path / "bright", tmp_path / "run-same", one_scale)
    good, bright, same = (tmp_path / f"run-{name}" for name in ("good", "bright", "same"))
    for found in (diagnose_run(bright, good), diagnose_run(same)):
        (scale,) = [cause for cause in found.causes if cause.name == "intensity scale"]
        assert scale.estimate == pytest.approx(-0.3, abs=0.01)
        assert scale.words == "intensities 30 % too high"
        assert scale.gain is None
    assert "intensity scale" not in {cause.name for cause in diagnose_run(bright).causes}


@pytest.fixture(scope="module")
def folder(scenario):
    return scenario("floor")


@pytest.fixture(autouse=True)
def shorter(monkeypatch):
    monkeypatch.setattr(tell_apart, "POINTS", 6000)
    for name, value in (("TREES", 20), ("TREES_ALONE", 5), ("SECTORS", 5)):
        monkeypatch.setattr(classifier, name, value)


def test_tell_apart_compares_the_run_with_its_floor_and_draws_the_map(folder, tmp_path):
    picture = tmp_path / "map.png"
    ended = command(
        "diagnose", folder / "run", "--tell-apart", "--floor", folder / "floor", "--picture", picture, "--json", code=0
    )
    found = json.loads(ended.stdout)["tell_apart"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert found["low"] <= found["auc"] <= found["high"]
    assert found["real_against_real"]["of"] == "second measurements of the floor"
    assert found["auc"] > found["real_against_real"]["auc"]  # the simulated side is drifted and thinned
    assert {one["name"] for one in found["families"]} == {"surface"}  # random points have no beams


def test_tell_apart_needs_no_pairs(folder):
    sides = [folder / "streets" / side for side in ("real", "sim")]
    ended = command("diagnose", *sides, "--tell-apart", code=0)
    assert "by surface alone" in ended.stdout
    assert "roughness" in ended.stdout


def test_two_sweeps_of_a_parked_sensor_are_indistinguishable(real_data):
    bag = real_data / "velodyne_vlp32c" / "rosbag1.bag"
    found = json.loads(command("diagnose", bag, bag, "--tell-apart", "--json").stdout)["tell_apart"]
    assert {one["name"] for one in found["families"]} == {"surface", "rays", "intensity"}
    base = found["real_against_real"]
    assert base["low"] <= 0.5 <= base["high"]
    assert base["high"] - base["low"] < 0.2
