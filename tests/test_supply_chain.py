"""Dependencies and network: locked libraries, no connections."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from itertools import islice
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from fidpipe.pipeline.storage.run_record import library_versions
from runs import FIDPIPE, some_of

HOUSE = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
#: Loaded by every Python process of a command; connections to other machines are logged and rejected.
GUARD = """
import os, sys

LOCAL = ("127.0.0.1", "::1", "localhost", b"127.0.0.1")

def _guard(event, arguments):
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg", "socket.bind"):
        host = arguments[1][0] if isinstance(arguments[1], tuple) else "127.0.0.1"  # else a socket of the file system
    elif event in ("socket.getaddrinfo", "socket.gethostbyname"):
        host = arguments[0] or "127.0.0.1"
    else:
        return
    if host not in LOCAL:
        with open(os.environ["NETWORK_LOG"], "a") as log:
            log.write(f"{event} {host}\\n")
        raise OSError(f"no network here: {event} {host}")

sys.addaudithook(_guard)
"""


def locked(name):
    """Version and hashes of each library of a lock, by name."""
    text = (HOUSE / name).read_text(encoding="utf-8")
    entries = re.findall(
        r"^([\w.-]+)(?:\[.*?\])?==([^ \\;]+)(.*?)(?=^\w|\Z)",
        text,
        flags=re.MULTILINE | re.DOTALL,
    )
    return {
        canonicalize_name(name): (version, re.findall(r"sha256:[0-9a-f]{64}", rest))
        for name, version, rest in entries
    }


@pytest.mark.parametrize(
    ("file", "extras"),
    [
        ("requirements.lock", PROJECT["optional-dependencies"]),
        ("requirements-run.lock", ["all"]),
    ],
)
def test_the_lock_has_each_requirement_with_a_version_that_fits_and_hashes(file, extras):
    versions = locked(file)
    for text in [
        *PROJECT["dependencies"],
        *(text for extra in extras for text in PROJECT["optional-dependencies"][extra]),
    ]:
        requirement = Requirement(text)
        if requirement.name != "fidpipe":
            found, _ = versions[canonicalize_name(requirement.name)]
            assert requirement.specifier.contains(found), (
                f"{text} is {found} in {file}; run make lock"
            )
    assert [name for name, (_, hashes) in versions.items() if not hashes] == []


def test_runs_and_tests_have_the_same_versions():
    everything = locked("requirements.lock")
    assert {
        name: version for name, (version, _) in locked("requirements-run.lock").items()
    }.items() <= {name: version for name, (version, _) in everything.items()}.items()


def test_every_extra_but_those_of_development_is_looked_at():
    (everything,) = PROJECT["optional-dependencies"]["all"]
    assert Requirement(everything).extras == PROJECT["optional-dependencies"].keys() - {
        "all",
        "dev",
        "docs",
    }


@pytest.fixture
def guarded(tmp_path):
    """Starts a command whose processes all have the guard; gives what they tried."""
    (tmp_path / "guard").mkdir()
    (tmp_path / "guard" / "sitecustomize.py").write_text(GUARD)
    log = tmp_path / "network.log"

    def start(*words, check=True):
        path = os.pathsep.join(
            [str(tmp_path / "guard"), *filter(None, [os.environ.get("PYTHONPATH")])]
        )
        environment = os.environ | {"PYTHONPATH": path, "NETWORK_LOG": str(log)}
        done = subprocess.run(
            [str(word) for word in words],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert not check or done.returncode == 0, done.stderr
        return log.read_text() if log.exists() else ""

    return start


def all_commands(dataset):
    """Commands of every family: synthetic data, a run on two workers, and its views."""
    yield FIDPIPE, "run", dataset, "--out", "a", "--workers", "2"
    yield FIDPIPE, "synth", "made", "--pairs", "1"
    yield FIDPIPE, "check", dataset
    yield (
        FIDPIPE,
        "run",
        dataset,
        "--out",
        "b",
        "--workers",
        "1",
        "--set",
        "metrics.baselines=all",
    )
    yield FIDPIPE, "report", "a"
    yield FIDPIPE, "compare", "a", "b", "--html", "compare.html", "--allow-different-settings"
    yield FIDPIPE, "show", "a", "000"
    yield FIDPIPE, "gate", "a", "--max", "cdc.mean=2"
    yield FIDPIPE, "export", "a", "--ply", "--mcap"
    yield FIDPIPE, "status", "a"
    yield (
        FIDPIPE,
        "best-case",
        dataset,
        "--out",
        "best_case",
        "--workers",
        "1",
        "--pairs",
        "000",
    )
    yield (
        FIDPIPE,
        "perturb",
        dataset,
        "--out",
        "perturbed",
        "--workers",
        "1",
        "--pairs",
        "000",
        "--repeats",
        "1",
    )
    yield FIDPIPE, "ablate", dataset, "--out", "ablated", "--workers", "1", "--pairs", "000"
    yield FIDPIPE, "settings"


@pytest.mark.parametrize(
    "code",
    [
        "socket.create_connection(('192.0.2.1', 80), 1)",
        "socket.getaddrinfo('example.org', 80)",
        "socket.socket().bind(('', 0))",
        "socket.socket().bind(('0.0.0.0', 0))",
        "socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'', ('192.0.2.1', 80))",
    ],
)
def test_the_guard_sees_who_reaches_out(guarded, code):
    assert "socket." in guarded(sys.executable, "-c", f"import socket; {code}", check=False)


@pytest.mark.parametrize("n_commands", some_of([1, None], [1]))
def test_no_command_reaches_out(guarded, dataset, n_commands):
    for words in islice(all_commands(dataset), n_commands):
        assert guarded(*words) == "", words


def test_an_extra_that_is_not_installed_has_no_version_and_stops_no_plan():
    assert library_versions(["no-such-library", "numpy"]) == {
        "no-such-library": "absent",
        "numpy": version("numpy"),
    }
