"""Recipes, records and run folders made by others: nothing outside is touched, and what is damaged is named."""

import hashlib
import io
import json
import re
import shutil

import orjson
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fidpipe.pipeline.datasets.pairs import Dataset
from fidpipe.pipeline.generate import synth, twin
from fidpipe.pipeline.report.render import terminal
from fidpipe.pipeline.report.view import Table
from fidpipe.pipeline.results.best_case import BEST_CASE_DATASET, BEST_CASE_RECIPE, read_recipe
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.pipeline.storage.ledger import LEDGER
from fidpipe.pipeline.storage.run_record import read_run
from fidpipe.pipeline.terminal import Terminal
from fidpipe.schemas.errors import FidpipeError, RunError
from runs import JOBS_PER_PAIR, QUIET, command, rewrite, run

TWIN = 'version = 1\nseed = 0\nsensor = "x"\ninputs_sha256 = "00"\nfiles = {}\n'


def twins(out, replace=True):
    """Makes the twins of a recording without a frame."""
    recording = Dataset(out.parent / "posed", (), {})
    twin.make_twins(recording, out, QUIET, twin.TwinRecipe(), replace=replace)


@pytest.mark.parametrize(
    "files", ['["../../victim"]', '["/etc/hostname"]', '[".."]', "[5]", '"0.bin"', "5"]
)
def test_a_recipe_that_names_files_elsewhere_is_none_of_ours(tmp_path, files):
    victim = tmp_path / "victim"
    out = tmp_path / "out"
    victim.write_text("precious")
    out.mkdir()
    (out / twin.RECIPE).write_text(TWIN.format(files))
    if files == '[".."]':
        (out / "real").mkdir()
        twins(out)
        assert (out / "real").is_dir()
    else:
        with pytest.raises(FidpipeError, match=str(out)):
            twins(out)
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("side", ["real", "sim"])
def test_a_side_that_is_a_link_is_not_cleared(tmp_path, side):
    """Files of another recipe are removed, but not through a link."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "0000.bin").write_text("precious")
    for name, recipe in (
        (twin.RECIPE, TWIN.format('["0000.bin"]')),
        (synth.RECIPE, TWIN.format("[]")),
    ):
        out = tmp_path / name
        out.mkdir()
        (out / name).write_text(recipe)
        (out / side).symlink_to(elsewhere)
        with pytest.raises(RunError, match=f"{side}: .*symbolic link"):
            twins(out) if name == twin.RECIPE else synth.make_dataset(
                out, QUIET, n_pairs=1, replace=True
            )
    assert (elsewhere / "0000.bin").read_text() == "precious"


@pytest.mark.parametrize(
    "change",
    ['noise_m = "much"', 'dataset = ["a"]', "seed = 1.5", "[noise_m]", "version = nan"],
)
def test_a_recipe_of_a_best_case_with_other_values_is_none(tmp_path, change):
    path = tmp_path / BEST_CASE_DATASET / BEST_CASE_RECIPE
    path.parent.mkdir()
    lines = [
        "version = 1",
        "noise_m = 0.02",
        "lost_share = 0.05",
        "seed = 0",
        'dataset = "a"',
    ]
    path.write_text("\n".join(lines))
    assert "0.02 m" in read_recipe(tmp_path).words
    name = change.strip("[]").partition(" ")[0]
    path.write_text("\n".join([*(line for line in lines if not line.startswith(name)), change]))
    assert read_recipe(tmp_path) is None


ESCAPE = "\x1b]0;owned\x07\x1b[2J\u202eevil\x9b31m"


def forged(folder, content):
    """Write the entry of a pair into a ledger, with the hash that belongs to it."""
    text = orjson.dumps(content)
    digest = hashlib.sha256(text).hexdigest().encode()
    (folder / LEDGER / "000.json").write_bytes(digest + b"\n" + text + b"\n")


@pytest.mark.parametrize(
    "name",
    ["../victim", "metrics/../../victim", "/etc/hostname", "metrics/.hidden", "run.json"],
)
def test_a_ledger_that_names_a_file_elsewhere_is_not_believed(again, dataset, tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    entry = orjson.loads((again / LEDGER / "000.json").read_bytes().split(b"\n")[1])
    for job in entry["jobs"]:
        job["files"][name] = next(iter(job["files"].values()))
    forged(again, entry)
    assert run(dataset, again).n_made == JOBS_PER_PAIR
    assert victim.read_text() == "precious"


@pytest.mark.parametrize(
    "content",
    [5, [[]], [None], "text", {"pair_id": "000", "jobs": [{"stage": 1}], "failure": 5}],
)
def test_an_entry_of_another_shape_counts_as_absent(again, content):
    forged(again, content)
    assert RunFolder(again).ledger.jobs("000") == {}


def test_a_cause_that_only_another_version_knew_is_left_out(again):
    """And one of this version that its table lacks is unknown."""

    def rename(causes):
        names = [
            "old cause" if name == "height" else name for name in causes["cause"].to_pylist()
        ]
        return causes.set_column(
            causes.schema.get_field_index("cause"), causes.schema.field("cause"), [names]
        )

    for path in (again / "causes").glob("*.parquet"):
        rewrite(again, f"causes/{path.name}", rename)
    causes = FinishedRun(again).mean_amounts
    assert "old cause" not in causes
    assert causes["height"].reason == "the run was made by a version without this cause"
    record = read_run(again)
    for cause in record["overview"]["causes"]:
        cause["name"] = "old cause"
    (again / "run.json").write_text(json.dumps(record))
    assert FinishedRun(again).diagnosis is None
    assert command("gate", again, "--max", "causes.height=0.05").returncode == 4


@pytest.mark.parametrize(
    "name", ["metrics", "ledger", ".writer", "run.json", "pairs.parquet", "report"]
)
def test_a_link_in_a_run_folder_is_refused_and_what_it_leads_to_stays(
    again, dataset, tmp_path, name
):
    outside = tmp_path / "outside"
    if (again / name).exists():
        shutil.move(again / name, outside)
    else:
        outside.mkdir()
    files = [outside] if outside.is_file() else [*outside.iterdir()]
    before = {path: path.read_bytes() for path in files}
    (again / name).symlink_to(outside)
    for use in (
        lambda: run(dataset, again),
        lambda: FinishedRun(again),
        lambda: RunFolder(again).ledger,
    ):
        with pytest.raises(RunError, match="symbolic link"):
            use()
            raise RunError("not refused")
    assert {path: path.read_bytes() for path in files} == before


def test_a_table_that_is_a_link_is_damaged(again, tmp_path):
    table = next((again / "metrics").glob("*.parquet"))
    shutil.move(table, tmp_path / "outside.parquet")
    table.symlink_to(tmp_path / "outside.parquet")
    with pytest.raises(RunError, match=re.escape(table.name)):
        _ = FinishedRun(again).metrics


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"settings": {"graph": 5}}',
        b'{"libraries": {"../x": "1"}, "wall_s": {}}',
        b'{"inputs": {"000": 3}, "wall_s": 1}',
        b'{"wall_s": {}, "summary": {"cdc_mean": {}}, "pairs": {}, "written": "x", "fidpipe": "y"}',
        b'{"dataset": "\\u0000", "settings": {}}',
        b'{"experiment": {}}',
    ],
)
def test_a_record_of_any_content_is_read_or_refused_in_one_line(again, dataset, content):
    (again / "run.json").write_bytes(content)
    for use in (read_run, FinishedRun, run_status, lambda folder: run(dataset, folder)):
        try:
            use(again)
        except FidpipeError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize(
    "kind", ["without a column", "with one more", "of other types", "empty of columns"]
)
def test_a_table_of_other_columns_is_refused(again, kind):
    name = "pairs.parquet"
    table = pq.read_table(again / name)
    other = {
        "without a column": table.drop_columns(["status"]),
        "with one more": table.append_column("more", pa.array([1] * len(table))),
        "of other types": table.set_column(0, "pair_id", pa.array([1.5] * len(table))),
        "empty of columns": pa.table({}),
    }[kind]
    rewrite(again, name, lambda rows: other)
    with pytest.raises(RunError, match=r"pairs\.parquet"):
        FinishedRun(again)


def test_no_name_steers_the_terminal():
    out = io.StringIO()
    console = Terminal(file=out, width=100, force_terminal=True, color_system="truecolor")
    console.print(terminal([Table("title", ("pair", "value"), [(ESCAPE, 1.0)])]))
    console.print(f"pair {ESCAPE}", markup=False, style="red")
    for sign in ("\x1b]", "\x1b[2J", "\x07", "\u202e", "\x9b"):
        assert sign not in out.getvalue()
    assert "\\u001b]0;owned" in out.getvalue()
    assert "\x1b[31m" in out.getvalue()  # colours of our own stay


def test_no_message_steers_the_terminal(tmp_path):
    folder = tmp_path / f"a{ESCAPE}\n[red]forged line"
    done = command("check", folder, code=1)
    assert "\x1b" not in done.stderr
    assert done.stderr.count("\n") == 1
