"""`fidpipe diagnose`: gains of the causes of a run, what no cause explains, latency; and --tell-apart."""

import json
import re
import shutil

import numpy as np
import pyarrow as pa
import pytest
from clusters import Cluster

from fidpipe.pipeline.diagnose import tell_apart
from fidpipe.pipeline.diagnose.diagnose import diagnose_run
from fidpipe.pipeline.diagnose.latency import follow, latency_note, latency_words, speed_m_s
from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.jobs import gains_job
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.storage.ledger import LEDGER
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.results import Diagnosis
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import load
from fidpipe.stages.causes.gain import Shares
from fidpipe.stages.diagnose import tell_apart as classifier
from fidpipe.stages.generate.ray_casting import fire
from fidpipe.stages.pieces import CutScan
from runs import QUIET, command, run
from scenes import street, write_bin

TOO_LOW_M, TRAVEL_M = 0.15, 0.5
SETTINGS = load(None, ["graph.k=10"], preset="reference")


def corner(seed):
    """A road between two walls with a box, sampled at random."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-15, 15, (2, 2500))
    z = rng.uniform(-1.5, 2, 2500)
    road = np.column_stack([x, y / 3, np.full(2500, -1.5)])
    walls = np.column_stack([x, np.where(y > 0, 5.0, -5.0), z])[:1500]
    end = np.column_stack([np.full(1500, 12.0), y[:1500] / 3, z[:1500]])
    return np.vstack([road, walls, end])


def write_drive(folder, displaced):
    """Three scans a tenth of a second apart, 0.5 m ahead of each other, whose simulated side is displaced."""
    rows = ["pair_id,real,sim,timestamp_s"]
    for i in range(3):
        real = corner(i) - [i * TRAVEL_M, 0, 0]
        sim = real + displaced + np.random.default_rng(i).normal(0, 0.01, real.shape)
        write_bin(folder / "real" / f"{i}.bin", real)
        write_bin(folder / "sim" / f"{i}.bin", sim)
        rows.append(f"{i},real/{i}.bin,sim/{i}.bin,{i / 10}")
    (folder / "pairs.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture(scope="module")
def low_run(tmp_path_factory):
    """A run of a simulator that is mounted too high."""
    folder = tmp_path_factory.mktemp("diagnose")
    run(write_drive(folder / "low", np.array([0, 0, -TOO_LOW_M])), folder / "run", SETTINGS)
    return folder / "run"


@pytest.fixture
def low(low_run, tmp_path):
    return shutil.copytree(low_run, tmp_path / "run")


def test_the_flaw_has_nearly_all_of_the_gain(low):
    shown = command("diagnose", low, "--workers", 1, "--json", code=0)
    diagnosis = Diagnosis.model_validate(json.loads(shown.stdout))
    first = diagnosis.causes[0]
    assert first.name == "height"
    assert first.estimate == pytest.approx(-TOO_LOW_M, abs=0.02)
    assert 0.8 < first.gain <= 1.05
    assert diagnosis.unexplained < 0.2
    assert FinishedRun(low).diagnosis == diagnosis
    assert "world 15 cm too low" in command("diagnose", low, "--workers", 1).stdout


def test_gains_are_computed_once(low, monkeypatch):
    before = diagnose_run(low, QUIET, Machines(1))
    monkeypatch.setattr(
        "fidpipe.pipeline.jobs.gains_job.shares", lambda *_: pytest.fail("computed again")
    )
    assert diagnose_run(low, QUIET, Machines(1)) == before


def test_a_pair_that_the_ledger_has_lost_is_named(low):
    (low / LEDGER / "1.json").write_text("")
    with pytest.raises(RunError, match=r"1\.json is damaged or gone; run it again"):
        diagnose_run(low, QUIET)


def test_an_interrupted_diagnosis_resumes_with_equal_gains(low, low_run, tmp_path, monkeypatch):
    """The second of three pairs is interrupted; the first one's gains are kept."""
    whole = diagnose_run(shutil.copytree(low_run, tmp_path / "whole"), QUIET, Machines(1))
    measure = gains_job.shares
    measured = []

    def interrupted(*arguments):
        if len(measured) == 1:
            raise KeyboardInterrupt
        measured.append(arguments)
        return measure(*arguments)

    monkeypatch.setattr("fidpipe.pipeline.jobs.gains_job.shares", interrupted)
    with pytest.raises(KeyboardInterrupt):
        diagnose_run(low, QUIET, Machines(1))
    assert len(list((low / "gains").glob("*.parquet"))) == 1
    assert FinishedRun(low).diagnosis is None

    monkeypatch.setattr("fidpipe.pipeline.jobs.gains_job.shares", measure)
    assert diagnose_run(low, QUIET, Machines(1)) == whole


@pytest.mark.exhaustive
def test_a_dask_scheduler_measures_the_same_gains(low, low_run, tmp_path):
    whole = diagnose_run(shutil.copytree(low_run, tmp_path / "whole"), QUIET, Machines(1))
    with Cluster(tmp_path / "cluster") as cluster:
        cluster.add_workers(2)
        assert diagnose_run(low, QUIET, Machines(scheduler=cluster.address)) == whole


def test_causes_whose_correction_does_not_help_are_doubtful(low, monkeypatch):
    def no_gain(scans, made, seam_deg, rng, best_case_m):
        return Shares(0.3, 0.3, best_case_m, dict.fromkeys(made, 0.0))

    monkeypatch.setattr("fidpipe.pipeline.jobs.gains_job.shares", no_gain)
    diagnosis = diagnose_run(low, QUIET, Machines(1))
    assert "world 15 cm too low" in diagnosis.doubtful
    assert diagnosis.unexplained == 1
    words = "seen, but fixing it would not help: world 15 cm too low"
    for shown in (command("diagnose", low, "--workers", 1), command("show", low)):
        text = " ".join(shown.stdout.split())
        assert f"Doubtful {words}" in text
        assert "unexplained: 100 % of the" in text
        assert "1 world 15 cm too low" not in text
    command("report", low)
    assert words in (low / "report.html").read_text(encoding="utf-8")


SPEEDS_M_S = np.array([2.0, 5.0, 8.0, 11.0, 14.0])
ERRORS_M = np.array([0.01, -0.01, 0.0, 0.01, -0.01])


@pytest.mark.parametrize(
    ("ahead_m", "speeds_m_s", "words"),
    [
        (0.05 * SPEEDS_M_S + ERRORS_M, SPEEDS_M_S, "grows with the speed: 4"),
        (0.4 + ERRORS_M, SPEEDS_M_S, "the same at any speed, so no latency"),
        (0.4 + ERRORS_M, np.full(5, 8.0), "or 50 ms of latency at 8 m/s"),
        (0.2 + 0.05 * SPEEDS_M_S + ERRORS_M, SPEEDS_M_S, "grows with the speed: 4"),
        (np.full(5, 0.4), np.full(5, np.nan), ""),
        (np.array([np.nan, 0.4]), np.array([8.0, 8.0]), "or 50 ms of latency at 8 m/s"),
        (np.full(5, 0.4), np.zeros(5), ""),
    ],
)
def test_latency_and_mounting_are_distinguished_by_the_speeds(ahead_m, speeds_m_s, words):
    found = latency_words(ahead_m, speeds_m_s)
    assert found.startswith(words)
    assert bool(found) == bool(words)


@pytest.mark.parametrize("travel_m", [0.4, 2.9])
def test_the_speed_is_that_of_the_motion_to_the_next_scan(travel_m):
    both = corner(0), corner(1) - [travel_m, 0, 0]
    scans = [CutScan(points, points[:, 2] < -1.4, points[:, 2] + 1.7) for points in both]
    speed = speed_m_s(*scans, 0.1)
    assert speed == pytest.approx(10 * travel_m, abs=0.5)


def test_the_next_scan_is_at_most_half_a_second_later():
    times_s = {"a": 0.0, "c": 0.5, "b": 0.2, "far": 9.0}
    following = follow(times_s, ["a", "b", "c", "far", "unknown"])
    rounded = {
        name: (later, round(duration_s, 3)) for name, (later, duration_s) in following.items()
    }
    assert rounded == {"a": ("b", 0.2), "b": ("c", 0.3)}


def test_a_world_too_far_ahead_may_be_late(tmp_path):
    run(write_drive(tmp_path / "late", np.array([0.3, 0, 0])), tmp_path / "run", SETTINGS)
    finished = FinishedRun(tmp_path / "run")
    causes = finished.record.overview.causes
    assert causes[0].name == "forward"
    words = re.fullmatch(
        r"forward: or (\d+) ms of latency at 5 m/s", latency_note(finished, causes)
    )
    assert int(words[1]) == pytest.approx(60, abs=5)
    assert latency_note(finished, []) == ""


def room(rng, low_m=(-18.0, -12.0, -1.8), high_m=(31.0, 9.0, 6.0)):
    """Returns of a VLP-16 in a room, with 5 mm of noise."""
    directions = fire(SENSORS["vlp16"], step_deg=0.4)
    range_m = (
        np.where(directions > 0, high_m, low_m) / np.where(directions == 0, 1e-9, directions)
    ).min(axis=1)
    return directions * (range_m + rng.normal(0, 0.005, len(range_m)))[:, None]


def test_the_scale_of_the_intensity_is_a_cause_if_both_sides_have_one_scale(tmp_path):
    rng = np.random.default_rng(7)
    for i in range(3):
        for side, scale in (("real", 1.0), ("sim", 1.3)):
            points = room(rng)
            intensity = (20 + 10 * (points[:, 1] > 0)) * scale
            write_bin(
                tmp_path / "bright" / side / f"{i}.bin", np.column_stack([points, intensity])
            )
    one_scale = load(None, ["graph.k=10", "input.intensity_scale=same"], preset="reference")
    run(tmp_path / "bright", tmp_path / "same", one_scale)
    run(tmp_path / "bright", tmp_path / "other", SETTINGS)
    (scale,) = [
        cause
        for cause in diagnose_run(tmp_path / "same", QUIET, Machines(1)).causes
        if cause.name == "intensity scale"
    ]
    assert scale.estimate == pytest.approx(-0.3, abs=0.01)
    assert scale.words == "intensities 30 % too high"
    assert scale.gain is None
    overview = FinishedRun(tmp_path / "other").overview
    assert "intensity scale" in {name for group in overview.unknown for name in group.causes}


@pytest.fixture(scope="module")
def folder(scenario):
    return scenario("best_case")


@pytest.fixture(autouse=True)
def shorter(monkeypatch):
    monkeypatch.setattr(tell_apart, "POINTS", 6000)
    for name, value in (("TREES", 20), ("TREES_ALONE", 5), ("SECTORS", 5)):
        monkeypatch.setattr(classifier, name, value)


def test_a_run_is_easier_to_tell_apart_than_its_best_case(folder):
    texts = [
        command("diagnose", folder / name, "--tell-apart", "--json", code=0).stdout
        for name in ("run", "best_case")
    ]
    found, second = [json.loads(text)["tell_apart"] for text in texts]
    assert found["low"] <= found["auc"] <= found["high"]
    assert found["real_against_real"]["of"] == "even and odd frames"
    assert found["auc"] > second["auc"]  # the simulated side is drifted and thinned
    # random points have no beams
    assert {one["name"] for one in found["families"]} == {"surface"}


def test_features_that_one_sample_lacks_do_not_tell_it_apart():
    points = street(seed=1)
    unknown = np.full(len(points), np.nan)
    columns = dict(zip("xyz", points.T, strict=True))
    columns |= {"height_m": points[:, 2], "is_ground": points[:, 2] < 0.3}
    grounds = [pa.table(columns | {"intensity": values}) for values in (points[:, 0], unknown)]
    a, b = [tell_apart.draw_sample([(ground, None)], 1) for ground in grounds]
    features = tell_apart.features_of(a)
    assert "intensity" in features
    assert tell_apart.compare_samples(a, b, features).auc < 0.6


def test_tell_apart_needs_no_pairs(folder):
    sides = [folder / "streets" / side for side in ("real", "sim")]
    ended = command("diagnose", *sides, "--tell-apart", code=0)
    assert "by surface alone" in ended.stdout
    assert "roughness" in ended.stdout


def test_two_sweeps_of_a_parked_sensor_are_indistinguishable(real_data):
    bag = real_data / "velodyne_vlp32c" / "rosbag1.bag"
    found = json.loads(command("diagnose", bag, bag, "--tell-apart", "--json").stdout)[
        "tell_apart"
    ]
    assert {one["name"] for one in found["families"]} == {"surface", "rays", "intensity"}
    base = found["real_against_real"]
    assert base["low"] <= 0.5 <= base["high"]
    assert base["high"] - base["low"] < 0.2
