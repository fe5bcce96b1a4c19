"""check --expect: settings of the simulated sensor against scans of a sensor in a round hall, whose truth is known."""

import json

import numpy as np
import pytest

from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.inspect.sensor_settings import read_sensor_settings
from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.settings import load
from runs import command

TRUE = {
    "channels": 16,
    "upper_fov": 15,
    "lower_fov": -15,
    "range": 31,
    "rotation_frequency": 10,
    "points_per_second": 160 * 900,
    "noise_stddev": 0.03,
    "dropoff_general_rate": 0.2,
    "dropoff_zero_intensity": 0.0,
    "atmosphere_attenuation_rate": 0.01,
    "noise_seed": 1,
}


def hall(seed, noise_m=0.03, lost=0.2, radius_m=30.0):
    """x, y, z, intensity of a scan of 16 beams with a firing every 0.4 degrees, in a round hall."""
    rng = np.random.default_rng(seed)
    elevation, azimuth = (np.radians(a).ravel() for a in np.meshgrid(np.linspace(-15, 15, 16), np.arange(0, 360, 0.4)))
    range_m = radius_m / np.cos(elevation)
    range_m += rng.normal(0, noise_m, range_m.shape)
    kept = rng.uniform(size=range_m.shape) >= lost
    level = range_m * np.cos(elevation)
    points = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), range_m * np.sin(elevation)])
    return np.column_stack([points, np.exp(-0.01 * range_m)])[kept].astype(np.float32)


@pytest.fixture(scope="module")
def halls(tmp_path_factory):
    """The real sensor has neither noise nor losses, and a larger hall."""
    folder = tmp_path_factory.mktemp("halls")
    for i in range(3):
        for side, scan in (("real", hall(i, 0, 0, 60)), ("sim", hall(i))):
            (folder / side).mkdir(exist_ok=True)
            scan.tofile(folder / side / f"{i}.bin")
    return folder


def compared(folder, settings, path):
    path.write_text(json.dumps(settings))
    found = check_dataset(folder, load(None, []), read_sensor_settings(path))
    return {one.name: one for one in found.settings}, [text for text in found.warnings if "simulated sensor:" in text]


def test_true_settings_are_seen_as_set(halls, tmp_path):
    found, warnings = compared(halls, {**TRUE, "noise_stddev": "0.03"}, tmp_path / "sensor.json")
    assert warnings == []
    assert {name for name, one in found.items() if one.verdict == "not checked"} == {
        "rotation_frequency", "dropoff_zero_intensity", "noise_seed",
    }  # fmt: skip
    assert found["noise_stddev"].seen == pytest.approx(0.03, rel=0.1)
    assert found["dropoff_general_rate"].seen == pytest.approx(0.2, abs=0.01)
    assert found["points_per_second"].seen == pytest.approx(TRUE["points_per_second"], rel=0.01)
    assert "no times" in found["rotation_frequency"].note and "seed" in found["noise_seed"].note


def test_settings_that_the_simulator_ignores_are_warnings(halls, tmp_path):
    """Each is far from the truth; the range is 100 m, but returns end at 31 m where the real ones reach 60 m."""
    other = {
        "channels": 32, "upper_fov": 10, "lower_fov": -30, "range": 100, "noise_stddev": 2.0,
        "dropoff_general_rate": 0.45, "atmosphere_attenuation_rate": 0.004, "rotation_frequency": 10,
        "points_per_second": 1e6, "horizontal_fov": 120,
    }  # fmt: skip
    found, warnings = compared(halls, other, tmp_path / "sensor.json")
    assert {name for name, one in found.items() if one.verdict == "differs"} == {*other} - {"rotation_frequency"}
    assert len(warnings) == len(other) - 1
    (noise,) = (text for text in warnings if "noise_stddev" in text)
    assert noise.startswith("simulated sensor: noise_stddev set 2 m, seen 0.03")
    assert noise.endswith(" m: the simulator ignores it")
    assert found["range"].note.startswith("real scans have ")
    missing, _ = compared(halls, {"dropoff_general_rate": 0, "noise_stddev": 0.001}, tmp_path / "sensor.json")
    assert missing["dropoff_general_rate"].verdict == missing["noise_stddev"].verdict == "differs"


def test_check_prints_and_returns_them(halls, tmp_path):
    path = tmp_path / "twin.toml"
    sensor = 'name = "recorded"\nelevation_deg = []\nrange_noise_m = 0.3\nlost_share = 0.2\n'
    path.write_text(f"flaw = []\n[sensor]\n{sensor}")
    shown = command("check", halls, "--expect", path)
    text = " ".join(shown.stdout.split())
    assert shown.returncode == 0 and "as set: lost_share set 0.2, seen 0." in text
    assert "warning: simulated sensor: range_noise_m set 0.3 m, seen 0.03" in text
    noise, lost = json.loads(command("check", halls, "--expect", path, "--json").stdout)["settings"]
    assert (noise["verdict"], lost["verdict"], lost["unit"]) == ("differs", "as set", "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise_stdev = 0.1", "unknown setting noise_stdev; did you mean noise_stddev?"),
        ("attenuate = 1", "unknown setting attenuate; known are atmosphere_attenuation_rate, "),
        ("noise_stddev = true", "noise_stddev: expected a number, got True"),
        ("range = [1, 2]", "range: expected a number, got"),
        ('channels = "many"', "channels: expected a number, got 'many'"),
        ("channels = 32.5", "channels: expected a whole number, got 32.5"),
        ("noise_stddev = -1", "noise_stddev: expected a number of at least 0, got -1"),
        ("dropoff_general_rate = 45", "dropoff_general_rate: expected a number from 0 to 1, got 45"),
        ("elevation_deg = [-15, 95]", "elevation_deg: expected a number from -90 to 90, got [-15, 95]"),
        ("channels = ", "expected settings in TOML or JSON"),
        ("", "expected a table of settings"),
    ],
)
def test_a_file_with_an_error_is_rejected_with_the_place(tmp_path, text, message):
    (path := tmp_path / "sensor.toml").write_text(text)
    with pytest.raises(FidpipeError, match="sensor.toml") as error:
        read_sensor_settings(path)
    assert message in str(error.value)
