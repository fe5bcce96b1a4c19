"""`fidpipe diagnose`: with --tell-apart, on a run, over a floor, and on two folders."""

import json

import pytest

from fidpipe.pipeline.diagnose import tell_apart
from fidpipe.stages.diagnose import tell_apart as classifier
from runs import command


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
        "diagnose", folder / "run", "--tell-apart", "--floor", folder / "floor", "--picture", picture, "--json"
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)["tell_apart"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert found["low"] <= found["auc"] <= found["high"]
    assert found["real_against_real"]["of"] == "second measurements of the floor"
    assert found["auc"] > found["real_against_real"]["auc"]  # the simulated side is drifted and thinned
    assert {one["name"] for one in found["families"]} == {"surface"}  # random points have no beams


def test_tell_apart_needs_no_pairs(folder):
    sides = [folder / "streets" / side for side in ("real", "sim")]
    ended = command("diagnose", *sides, "--tell-apart")
    assert ended.returncode == 0, ended.stderr
    assert "by surface alone" in ended.stdout
    assert "roughness" in ended.stdout
    assert "the two folders may show different places" in ended.stdout


def test_two_sweeps_of_a_parked_sensor_are_indistinguishable(real_data):
    bag = real_data / "velodyne_vlp32c" / "rosbag1.bag"
    found = json.loads(command("diagnose", bag, bag, "--tell-apart", "--json").stdout)["tell_apart"]
    assert {one["name"] for one in found["families"]} == {"surface", "rays", "intensity"}
    base = found["real_against_real"]
    assert base["low"] <= 0.5 <= base["high"]
    assert base["high"] - base["low"] < 0.2


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (("elsewhere",), 2, "--tell-apart"),
        (("--tell-apart", "--set", "input.min_range_m=1"), 2, "two folders"),
    ],
)
def test_wrong_usage_is_explained(folder, words, code, text):
    ended = command("diagnose", folder / "run", *words)
    assert ended.returncode == code
    assert text in ended.stderr
