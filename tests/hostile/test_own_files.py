"""Files that fidpipe wrote itself, or that lie where it writes, changed by others: recipes, records, label names."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from campaign import campaign
from fidpipe.pipeline.cli import completion
from fidpipe.pipeline.engine.progress import Reporter
from fidpipe.pipeline.exchange.convert import convert
from fidpipe.pipeline.generate import synth, twin
from fidpipe.pipeline.generate.recordings import Recording
from fidpipe.pipeline.generate.sensor_files import read_sensor
from fidpipe.pipeline.results.floor import FLOOR_DATASET, FLOOR_RECIPE, read_recipe
from fidpipe.schemas.errors import DatasetError, FidpipeError, RunError

QUIET = Reporter(Console(quiet=True))
TWIN = 'version = 1\nseed = 0\nsensor = "x"\ninputs_sha256 = "00"\nfiles = {}\n'


def twins(out, replace=True):
    """Makes the twins of a recording without a frame."""
    recording = Recording(out.parent / "posed", Path("poses.tum"), (), {})
    twin.make_twins(recording, out, QUIET, replace=replace)


@pytest.mark.parametrize(
    "text", ['"a\nb",elevation_deg\n1,2\n', "elevation_deg\n" + "x" * 5000, "elevation_deg\n1,2\n\x00\n1,2,3,4\n"]
)
def test_a_sensor_table_is_refused_in_one_short_line(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FidpipeError) as caught:
        read_sensor(str(tmp_path / "a.csv"))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", [1797, 18581])
def test_a_recipe_of_names_longer_than_a_files_is_read(number):
    assert campaign("recipe", 1, first=number)[0] == []


@pytest.mark.parametrize("files", ['["../../victim"]', '["/etc/hostname"]', '[".."]', "[5]", '"0.bin"', "5"])
def test_a_recipe_that_names_files_elsewhere_is_none_of_ours(tmp_path, files):
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.write_text("precious")
    out.mkdir()
    (out / twin.RECIPE).write_text(TWIN.format(files))
    if files == '[".."]':
        (out / "real").mkdir()
        twins(out)
        assert (out / "real").is_dir()
    else:
        with pytest.raises(FidpipeError, match="holds other things than a dataset of fidpipe"):
            twins(out)
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("side", ["real", "sim"])
def test_a_side_that_is_a_link_is_not_cleared(tmp_path, side):
    """Files of another recipe are removed, but not through a link."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "0000.bin").write_text("precious")
    for name, recipe in ((twin.RECIPE, TWIN.format('["0000.bin"]')), (synth.RECIPE, TWIN.format("[]"))):
        out = tmp_path / name
        out.mkdir()
        (out / name).write_text(recipe)
        (out / side).symlink_to(elsewhere)
        with pytest.raises(RunError, match=f"{side}: expected a folder, got a symbolic link"):
            twins(out) if name == twin.RECIPE else synth.make_dataset(out, QUIET, n_pairs=1, replace=True)
    assert (elsewhere / "0000.bin").read_text() == "precious"


@pytest.mark.parametrize(
    "change", ['noise_m = "much"', "kind = 5", 'dataset = ["a"]', "seed = 1.5", "[noise_m]", "version = nan"]
)
def test_a_recipe_of_a_floor_with_other_values_is_none(tmp_path, change):
    path = tmp_path / FLOOR_DATASET / FLOOR_RECIPE
    path.parent.mkdir()
    lines = ["version = 1", 'kind = "again"', "noise_m = 0.02", "lost_share = 0.05", "seed = 0", 'dataset = "a"']
    path.write_text("\n".join(lines))
    assert read_recipe(tmp_path).words == "range noise 0.02 m, dropout 0.05, seed 0"
    name = change.strip("[]").partition(" ")[0]
    path.write_text("\n".join([*(line for line in lines if not line.startswith(name)), change]))
    assert read_recipe(tmp_path) is None


@pytest.mark.parametrize(
    "record", [[], 5, {"inputs": 5}, {"inputs": [5, {}]}, {"inputs": None, "stages": "graph"}, "[" * 100_000]
)
def test_a_record_of_any_content_offers_no_names(tmp_path, record):
    text = record if isinstance(record, str) else json.dumps(record)
    (tmp_path / "run.json").write_text(text)
    context = SimpleNamespace(params={"run": tmp_path, "out": tmp_path}, args=[])
    assert completion.pairs(context, "") == []
    assert completion.stages(context, "") == []


@pytest.mark.parametrize("names", ['car = "car"', "[1]", "= 5", '"\\ud800" = 1'])
def test_names_of_labels_of_any_content_are_added_to_or_refused(tmp_path, names):
    (tmp_path / "scan.csv").write_text("x,y,z,label\n1,2,3,car\n4,5,6,tree\n")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "labels.toml").write_text(names)
    with pytest.raises(DatasetError, match=r'labels\.toml: expected lines such as 4 = "tree"|labels.toml: 1 is'):
        convert(tmp_path / "scan.csv", tmp_path / "out" / "a.ply")
    assert (tmp_path / "out" / "labels.toml").read_text() == names
