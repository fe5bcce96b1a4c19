"""Results that a user could lose: replaced too early, by mistake, or by an interrupt at the wrong moment."""

import json
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from fidpipe.pipeline.engine import cluster, prefork
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.status import run_status
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.record import RunHeader
from fidpipe.schemas.settings import load
from runs import command, contents, marks, run

NO_CLUSTER = "tcp://127.0.0.1:9"


def test_a_run_without_its_cluster_removes_nothing(again, dataset, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_TIMEOUT_S", 1)
    before = contents(again)
    with pytest.raises(RunError, match=NO_CLUSTER):
        run(
            dataset,
            again,
            load(None, ["communities.seed=3"]),
            workers=None,
            scheduler=NO_CLUSTER,
        )
    assert contents(again) == before
    assert run(dataset, again).n_made == 0


@pytest.mark.parametrize(
    "word", ["matching.delta_m=3", "communities.seed=3", "input.max_range_m=50"]
)
def test_a_finished_run_is_not_replaced_by_another_setting_unasked(again, dataset, word):
    before = contents(again)
    name, _, value = word.partition("=")
    with pytest.raises(RunError, match=rf"{name} was .*, is {value}.*--replace"):
        run(dataset, again, load(None, [word]), replace=False)
    assert contents(again) == before
    assert run(dataset, again, load(None, [word]), replace=True).n_made > 0


def test_results_of_an_older_version_are_not_replaced_unasked(again, dataset):
    record = json.loads((again / "run.json").read_text()) | {
        "fidpipe": "0.0.9",
        "written": "2025-01-02T03:04:05",
    }
    del record["sha256"]
    (again / "run.json").write_text(json.dumps(record))
    before = contents(again)
    stages = tuple(
        replace(stage, version=stage.version + (stage.name == "metrics")) for stage in STAGES
    )
    with pytest.raises(RunError, match=r"0\.0\.9 on 2025-01-02 .* metrics.*--replace"):
        run(dataset, again, stages=stages, replace=False)
    assert contents(again) == before
    del record["pairs"]  # a record that cannot be read
    (again / "run.json").write_text(json.dumps(record))
    with pytest.raises(RunError, match=re.escape(str(again))):
        FinishedRun(again)
    run(dataset, again, replace=False)
    assert FinishedRun(again).scored


def test_a_setting_that_replaces_nothing_needs_no_leave(again, dataset):
    assert (
        run(dataset, again, load(None, ["metrics.baselines=chamfer"]), replace=False).n_made
        == 2
    )
    assert run(dataset, again, load(None, ["machine.memory_gib=4"]), replace=False).n_made == 0


def test_a_stage_asked_for_by_from_needs_no_leave(again, dataset):
    settings = load(None, ["matching.delta_m=3"])
    assert run(dataset, again, settings, replace=False, from_stage="matching").n_made == 16


def test_an_unfinished_run_takes_other_settings_as_before(again, dataset):
    leave_unfinished(again)
    assert run(dataset, again, load(None, ["matching.delta_m=3"]), replace=False).n_made == 6


def test_the_hint_to_finish_a_run_keeps_its_settings(dataset, tmp_path):
    out = tmp_path / "my runs" / "seed 3"
    run(dataset, out, load(None, ["communities.seed=3"]))
    leave_unfinished(out)
    (out / "metrics" / "001.parquet").unlink()
    before = marks(out)
    for words in (("show", out), ("status", out)):
        result = command(*words)
        hint = re.search("finish it with: fidpipe (.*)", result.stdout + result.stderr)[1]
        assert shlex.split(hint) == [
            "run",
            str(dataset),
            "--out",
            str(out),
            "--settings",
            str(out / "settings.toml"),
        ]
    assert command(*shlex.split(hint), "--workers", 1).returncode == 0
    after = marks(out)
    assert {name: after[name] for name in before} == before
    assert run_status(out).stages["metrics"] == {"done": 2}
    assert "finish it with" not in command("status", out).stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_something_starts_waits_and_is_not_lost(number, monkeypatch):
    before = signal.signal(number, signal.default_int_handler)
    started = []
    try:
        with pytest.raises(KeyboardInterrupt), prefork.interrupts_afterwards():
            signal.raise_signal(number)
            started.append(True)
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    assert started


COLLECTING = """
import gc, signal
from fidpipe.pipeline.cli import main

def interrupt(phase, _):
    if isinstance(signal.getsignal(signal.SIGINT), main._Stop) and phase == "stop":
        gc.callbacks.remove(interrupt)
        signal.raise_signal(signal.SIGINT)

gc.callbacks.append(interrupt)
main.main()
"""


def test_an_interrupt_while_python_collects_garbage_is_not_lost(dataset, tmp_path):
    words = ("run", dataset, "--out", tmp_path / "run", "--workers", "1")
    ended = subprocess.run(
        [sys.executable, "-c", COLLECTING, *words], check=False, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (
        130,
        "interrupted; run the same command again to resume\n",
    )


def test_what_killed_workers_leave_is_removed_without_a_word():
    left = "from multiprocessing import resource_tracker; resource_tracker.register('/fidpipe-left', 'semaphore')"
    code = f"from fidpipe.pipeline.engine import prefork; prefork.start(); {left}"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert ended.stderr == ""


def leave_unfinished(out):
    """Makes of a run's record what it was when the run began."""
    record = json.loads((out / "run.json").read_text())
    header = {name: record[name] for name in RunHeader.model_fields}
    (out / "run.json").write_text(json.dumps(header))
