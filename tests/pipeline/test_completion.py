"""Completion in the shell: the names that are offered, and Tab in a real bash and a real zsh."""

import os
import shutil
from pathlib import Path
from unittest import mock

import pexpect
import pytest

from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.measures import Measures
from fidpipe.schemas.settings import Settings
from runs import FIDPIPE, STAGE_NAMES, command


@pytest.fixture(scope="module")
def place(finished, tmp_path_factory):
    """A folder with a finished run in runs/streets, as after `fidpipe run streets`."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "runs").mkdir()
    (folder / "runs" / "streets").symlink_to(finished)
    (folder / "notes").mkdir()
    return folder


def offered(place, line):
    """Words that bash offers for the last word of a line."""
    words = line.split(" ")
    asked = {
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
        "_FIDPIPE_COMPLETE": "complete_bash",
    }
    with mock.patch.dict(os.environ, asked):
        answer = command("", cwd=place)
    assert (answer.returncode, answer.stderr) == (0, "")
    return answer.stdout.split()


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("fidpipe show ", ["runs/streets"]),
        ("fidpipe show runs/", ["runs/streets"]),
        ("fidpipe compare runs/streets r", ["runs/streets"]),
        ("fidpipe show no", []),
        ("fidpipe show nowhere/", []),
        ("fidpipe show runs/streets ", ["000", "001"]),
        ("fidpipe show notes ", []),
        ("fidpipe run streets --from ", STAGE_NAMES),
        ("fidpipe run other --out runs/streets --from me", ["metrics"]),
        ("fidpipe run other --from ", []),
        ("fidpipe run streets --preset ", ["paper", "reference"]),
        (
            "fidpipe run streets --set graph.",
            ["graph.k=", "graph.tau_m=", "graph.edges=", "graph.ties="],
        ),
    ],
)
def test_names_are_offered(place, line, names):
    assert offered(place, line) == names


def test_every_measure_that_is_offered_can_be_measured(place):
    names = offered(place, "fidpipe gate runs/streets --max ")
    assert "r_lambda.mean=" in names
    measures = Measures(FinishedRun(place / "runs" / "streets"))
    for name in names:
        if not name.startswith("excess."):
            measures.named(name.removesuffix("="))


def test_every_setting_is_offered(place):
    assert len(offered(place, "fidpipe run streets --set ")) == sum(
        len(dict(group)) for _, group in Settings()
    )


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_completes_after_install_completion(shell, place, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    path = f"{Path(FIDPIPE).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {"HOME": str(tmp_path), "PATH": path, "TERM": "xterm", "LANG": "C.UTF-8"}
    environment["PYTHONPATH"] = os.environ.get("PYTHONPATH", "")
    options = {
        "cwd": str(place),
        "env": environment,
        "encoding": "utf-8",
        "timeout": 60,
        "dimensions": (40, 200),
    }
    installed = pexpect.run(f"{shell} -c 'fidpipe --install-completion; echo code $?'", **options)
    assert "code 0" in installed
    assert f"{shell} completion installed" in installed
    terminal = pexpect.spawn(shell, ["-i"], **options)
    try:
        for line, rest in [
            ("fidpipe sett", "ings"),
            ("fidpipe show ru", "ns/streets"),
            ("fidpipe run streets --preset re", "ference"),
            ("fidpipe run streets --from gra", "ph"),
            ("fidpipe run streets --set graph.ta", "u_m="),
            ("fidpipe gate runs/streets --max r_gap.st", "d="),
            ("fidpipe check no", "tes"),
        ]:
            assert completes(terminal, line, rest), (line, terminal.before)
    finally:
        terminal.close(force=True)


def completes(terminal, line, rest):
    """True if Tab appends the rest; tried three times: the first Tab of a zsh only loads typer's functions."""
    for _ in range(3):
        terminal.send(line)
        terminal.expect_exact(line[-2:])  # a Tab among typed-ahead keys completes nothing in zsh
        terminal.send("\t")
        found = terminal.expect_exact([rest, pexpect.TIMEOUT], timeout=10)
        terminal.sendcontrol(
            "u"
        )  # Ctrl-C would take along what is typed before the shell has dealt with it
        if found == 0:
            return True
    return False
