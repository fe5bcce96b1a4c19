import pytest

from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.settings import load


def test_words_win_over_the_file_and_the_file_over_the_defaults(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text('[graph]\nk = 60\ntau_m = 0.3\n[matching]\nmethod = "optimal"\n')
    boxes = ["input.exclude_box=-1 -1 -1 1 1 1", "input.include_box=-9,-9,-1,9,9,1"]
    settings = load(file, ["graph.k=70", "ground.method=none", *boxes])
    assert (settings.graph.k, settings.graph.tau_m, settings.matching.method) == (70, 0.3, "optimal")
    assert (settings.ground.method, settings.input.exclude_box) == ("none", (-1, -1, -1, 1, 1, 1))
    assert settings.input.include_box == (-9, -9, -1, 9, 9, 1)


@pytest.mark.parametrize(
    ("word", "fault"),
    [
        ("graph.k=0", "setting graph.k: expected a number of at least 1, got 0; fidpipe settings lists"),
        ("graph.k=many", "setting graph.k: expected a whole number, got 'many'"),
        ("graph.kk=3", "setting graph.kk: no such setting; known are graph.k, graph.tau_m, graph.edges"),
        ("grph.k=3", "setting grph: no such setting; known are input, ground, graph"),
        ("k=3", "--set 'k=3': expected GROUP.NAME=VALUE"),
        ("graph.k", "--set 'graph.k': expected GROUP.NAME=VALUE"),
        ("matching.method=best", "setting matching.method: expected 'greedy' or 'optimal', got 'best'"),
        ("matching.delta_m=nan", "setting matching.delta_m: expected a finite number, got nan"),
        ("input.min_range_m=200", "setting input: expected min_range_m below max_range_m, got 200 and 100"),
        ("input.columns=x,y", "expected x, y and z among the names"),
        ("input.exclude_box=1,1,1,0,2,2", "expected each minimum below its maximum"),
        ("input.include_box=1,2", "setting input.include_box"),
        ('input.exclude_box="1 2 3"', "expected six numbers (xmin ymin zmin xmax ymax zmax), got 3"),
        ("input.exclude_box=[1, 2, 3]", "expected six numbers (xmin ymin zmin xmax ymax zmax), got 3"),
        ("input.exclude_box=1 2 3", "expected six numbers (xmin ymin zmin xmax ymax zmax), got 3"),
    ],
)
def test_a_wrong_word_is_named(word, fault):
    with pytest.raises(SettingsError) as error:
        load(None, [word])
    assert fault in str(error.value)
    assert "\n" not in str(error.value)


def test_a_shared_cut_needs_the_pca_method():
    with pytest.raises(SettingsError, match='expected method = "pca" with shared = true, got "none"'):
        load(None, ["ground.shared=true", "ground.method=none"])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[graph\n", "not valid TOML"),
        ("graph = 3\n", "s.toml: setting graph: expected a table, got 3"),
        ("[input]\nmin_range_m = 200\n", "s.toml: setting input: expected min_range_m below"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, text, fault):
    file = tmp_path / "s.toml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=fault):
        load(file)


def test_the_mirror_is_the_frame_of_carla():
    flipped, named = load(None, ["input.sim_flip_y=true"]).input, load(None, ["input.sim_frame=carla"]).input
    assert flipped.frame_of("sim") == named.frame_of("sim") == "carla"
    assert flipped.frame_of("real") == "ros"


@pytest.mark.parametrize("frame", ["carla", "nuscenes", "kitti-cam"])
def test_a_mirror_beside_a_frame_is_refused(frame):
    with pytest.raises(SettingsError, match=f'expected sim_flip_y = true only .*, got "{frame}".*remove sim_flip_y'):
        load(None, ["input.sim_flip_y=true", f"input.sim_frame={frame}"])


def test_an_unknown_frame_is_answered_with_the_axes_of_those_that_are_known():
    with pytest.raises(
        SettingsError, match=r"expected one of ros \(x forward, y left, z up\), carla .* metres, got 'enu'"
    ):
        load(None, ["input.real_frame=enu"])
