"""Properties of any name, number and text; hypothesis looks for the smallest one that breaks them."""

import tempfile
import tomllib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fidpipe.pipeline.datasets.pairs import (
    check_rigid,
    read_dataset,
    read_label_names,
    read_manifest,
)
from fidpipe.pipeline.datasets.readers.scan import scan_from_columns
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref
from fidpipe.pipeline.results.gate import parse_word, read_criteria
from fidpipe.pipeline.storage.table_files import file_stem, table_name
from fidpipe.pipeline.terminal import shown
from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.settings import load, parse
from fidpipe.schemas.settings_text import to_toml

settings.register_profile(
    "here", deadline=None, max_examples=50, suppress_health_check=list(HealthCheck)
)
settings.load_profile("here")

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=60)
NAME = st.one_of(
    TEXT,
    st.sampled_from(
        ["..", ".", "/", "a/../../b", "\0", "CON", "nul.txt", "x" * 300, "~", "-", " "]
    ),
)
SCALAR = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), TEXT)
VALUE = st.recursive(
    SCALAR, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4)
)


@given(NAME.filter(bool))
def test_no_pair_is_written_outside_of_its_folder(pair_id):
    name = table_name("metrics", pair_id, "real")
    assert name.count("/") == 1
    assert "\0" not in name
    assert Path("/run", name).resolve().parent == Path("/run/metrics")
    assert not Path(name).name.startswith(".")
    assert len(Path(name).name.encode()) <= 160


@given(NAME.filter(bool), NAME.filter(bool))
def test_two_pairs_never_share_a_file(a, b):
    assert (file_stem(a) == file_stem(b)) == (a == b)


@given(TEXT)
def test_what_is_shown_steers_nothing_and_stays_as_it_is(text):
    assert shown(shown(text)) == shown(text)
    assert all(
        sign.isprintable() or sign not in "\x1b\x07\x08\r\n\x9b\u202e" for sign in shown(text)
    )


@given(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=80))
def test_any_path_names_a_file_or_a_frame_or_is_refused(text):
    with suppress(FidpipeError):
        scan = scan_ref(text)
        assert str(scan.file) in str(Path(text)) or str(scan.file) == "."
        assert scan.time_ns is None or scan.time_ns >= 0


@given(st.dictionaries(TEXT, VALUE, max_size=4))
def test_any_settings_are_taken_or_refused(values):
    try:
        taken = parse(values)
    except FidpipeError:
        return
    assert parse(tomllib.loads(to_toml(taken))) == taken


@given(
    st.sampled_from(["graph.k", "input.max_range_m", "matching.delta_m", "communities.seed"]),
    TEXT,
)
def test_any_word_is_a_setting_or_is_refused(name, text):
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        try:
            load(None, [f"{name}={text}"])
        except FidpipeError as error:
            assert name.partition(".")[0] in str(error)


@given(
    st.dictionaries(
        TEXT, st.lists(st.dictionaries(TEXT, VALUE.filter(lambda v: v is not None)), max_size=3)
    )
)
def test_any_criteria_are_taken_or_refused(values):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.toml")
        try:
            path.write_text(
                tomli_w.dumps(values | {"criterion": next(iter(values.values()), [])}),
                encoding="utf-8",
            )
        except (TypeError, ValueError, UnicodeEncodeError):
            return  # not TOML at all
        with pytest.raises(FidpipeError):
            read_criteria(path)


@given(TEXT)
def test_any_word_is_a_criterion_or_is_refused(text):
    with suppress(FidpipeError):
        assert np.isfinite(parse_word(text, "max").limit)


@given(st.lists(st.tuples(NAME, NAME, NAME, TEXT, TEXT), max_size=4))
def test_any_manifest_is_read_or_refused(rows):
    import csv

    with tempfile.TemporaryDirectory() as folder:
        with Path(folder, "pairs.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(
                [["pair_id", "real", "sim", "timestamp_s", "T_real_sim"], *rows]
            )
        with suppress(FidpipeError):
            pairs = read_manifest(Path(folder, "pairs.csv"), [])
            read_dataset(Path(folder))
            assert all(pair.fault for pair in pairs)


@given(st.lists(st.floats(), max_size=13))
def test_any_numbers_are_a_rigid_motion_or_are_refused(numbers):
    with suppress(FidpipeError):
        motion = check_rigid("here: T", np.array(numbers, dtype=np.float64))
        assert motion.shape == (3, 4)
        assert np.isfinite(motion).all()


@given(
    st.dictionaries(
        st.sampled_from(["x", "y", "z", "label", "ring", "time", "i"]),
        st.lists(SCALAR, max_size=4),
    )
)
def test_any_columns_are_a_scan_or_are_refused(columns):
    arrays = {}
    for name, values in columns.items():
        arrays[name] = np.empty(len(values), dtype=object)
        arrays[name][:] = values
    with suppress(FidpipeError):
        scan = scan_from_columns(Path("a.csv"), arrays)
        assert scan.points.dtype == np.float64
        assert scan.points.shape == (len(arrays["x"]), 3)


@pytest.mark.parametrize("opened", ["[" * 100_000, "{a=" * 100_000])
def test_lists_in_lists_without_end_are_refused(tmp_path, opened):
    (tmp_path / "a.toml").write_text(f"a = {opened}\n")
    (tmp_path / "labels.toml").write_text(f"1 = {opened}\n")
    for read in (
        lambda: load(tmp_path / "a.toml"),
        lambda: load(None, [f"graph.k={opened}"]),
        lambda: read_criteria(tmp_path / "a.toml"),
        lambda: read_label_names(tmp_path),
    ):
        with pytest.raises(FidpipeError):
            read()
