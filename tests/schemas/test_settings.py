import pytest

from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.settings import load


def test_words_win_over_the_file_and_the_file_over_the_defaults(tmp_path):
    file = tmp_path / "s.toml"
    file.write_text('[graph]\nk = 60\ntau_m = 0.3\n[matching]\nmethod = "optimal"\n')
    boxes = ["input.exclude_box=-1 -1 -1 1 1 1", "input.include_box=-9,-9,-1,9,9,1"]
    settings = load(file, ["graph.k=70", "ground.method=none", *boxes])
    assert (settings.graph.k, settings.graph.tau_m, settings.matching.method) == (
        70,
        0.3,
        "optimal",
    )
    assert (settings.ground.method, settings.input.exclude_box) == (
        "none",
        (-1, -1, -1, 1, 1, 1),
    )
    assert settings.input.include_box == (-9, -9, -1, 9, 9, 1)


@pytest.mark.parametrize(
    ("word", "fault"),
    [
        ("graph.k=0", "graph.k: "),
        ("graph.k=many", "graph.k: "),
        ("graph.kk=3", "graph.kk"),
        ("grph.k=3", "grph"),
        ("k=3", "'k=3'"),
        ("matching.method=best", "matching.method: "),
        ("matching.delta_m=nan", "matching.delta_m"),
        ("input.min_range_m=200", "got 200 and 100"),
        ("input.columns=x,y", "input.columns"),
        ("input.exclude_box=1,1,1,0,2,2", "input.exclude_box"),
        ('input.exclude_box="1 2 3"', "input.exclude_box: "),
    ],
)
def test_a_wrong_word_is_named(word, fault):
    with pytest.raises(SettingsError) as error:
        load(None, [word])
    assert fault in str(error.value)
    assert "\n" not in str(error.value)


def test_a_shared_cut_needs_the_pca_method():
    with pytest.raises(SettingsError, match="method.*shared"):
        load(None, ["ground.shared=true", "ground.method=none"])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[graph\n", "s.toml"),
        ("graph = 3\n", "s.toml: setting graph"),
        ("[input]\nmin_range_m = 200\n", "s.toml: setting input"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, text, fault):
    file = tmp_path / "s.toml"
    file.write_text(text)
    with pytest.raises(SettingsError, match=fault):
        load(file)


@pytest.mark.parametrize("preset", [None, "paper"])
def test_the_preset_is_no_group_of_settings(preset):
    with pytest.raises(SettingsError, match="preset"):
        load(None, ["preset.x=1"], preset=preset)
