"""All that fidpipe reads from disk is attacked: each format, and each module that opens a file."""

import ast
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import fidpipe
from attack import write_input
from fidpipe.pipeline.datasets.readers import FORMATS
from fidpipe.schemas.errors import FidpipeError
from targets import TARGETS

ROOT = Path(fidpipe.__file__).parent
#: Functions, and methods of any object, that open a file for reading.
FUNCTIONS = {"open", "read_content"}
METHODS = {"read_text", "read_bytes", "open", "fromfile", "loadtxt", "read_csv", "read_parquet", "ParquetFile"}
OF_MODULES = {("np", "load"), ("pq", "read_table"), ("json", "load"), ("sqlite3", "connect"), ("tomllib", "load")}
OF_MODULES |= {("np", "memmap"), ("yaml", "safe_load"), ("orjson", "load"), ("pickle", "load"), ("mmap", "mmap")}
#: Modules that open only files of their own, or files that another module has read before.
NOT_ATTACKED = {
    "pipeline.engine.cluster": "its own code and shared file, to be compared with those of the user's other machines",
    "pipeline.engine.worker_start": "/proc/self/statm",
    "pipeline.engine.time_limit": "notes of its own processes, in a folder that goes with them",
    "pipeline.cli.main": "/dev/null",
    "pipeline.cli.show_report_export": "a browser, for a page that it has made",
    "pipeline.report.page.page_templates": "its own scripts and styles",
    "pipeline.remote.remote_dataset": "its own stubs",
    "pipeline.storage.urls": "its own stubs",
    "pipeline.remote.remote_run": "its own index, and files that are read as a run afterwards",
    "pipeline.generate.floor_run": "copies labels.toml, which the dataset's reader has read",
    "pipeline.generate.twin": "copies scans and labels, which the reader of scans has read",
    "schemas.data_files": "its own tables",
    "stages.ground": "/dev/null",
}


def opens_files(path):
    """True if a module calls functions that open files."""
    calls = [node.func for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = {call.id for call in calls if isinstance(call, ast.Name)}
    methods = {call.attr for call in calls if isinstance(call, ast.Attribute)}
    attributes = [call for call in calls if isinstance(call, ast.Attribute) and isinstance(call.value, ast.Name)]
    of_modules = {(call.value.id, call.attr) for call in attributes}
    return bool(names & FUNCTIONS or methods & METHODS or of_modules & OF_MODULES)


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """The modules of ours that had a file opened while each target read its whole inputs."""
    found, state = set(), {"on": False}

    def hook(event, values):
        if state["on"] and event in ("open", "sqlite3.connect"):
            frame = sys._getframe(1)
            while frame is not None:
                name = frame.f_globals.get("__name__") or ""
                if name.startswith("fidpipe."):
                    found.add(name.removeprefix("fidpipe."))
                frame = frame.f_back

    inputs = {name: target.inputs() for name, target in TARGETS.items()}
    sys.addaudithook(hook)
    for name, target in TARGETS.items():
        for files in inputs[name]:
            folder = tmp_path_factory.mktemp("whole")
            write_input(folder, files)
            state["on"] = True
            with suppress(FidpipeError):
                target.read(folder)
            state["on"] = False
    return found


def test_each_format_has_a_target():
    changed = {
        "/" + file
        for target in TARGETS.values()
        for files in target.inputs()
        for file in files
        if file.startswith(target.hot)
    }
    assert [suffix for suffix in FORMATS if not any(file.lower().endswith(suffix) for file in changed)] == []


def test_each_module_that_opens_files_reads_those_of_a_target(seen):
    modules = {
        path: ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for room in ("pipeline", "stages", "schemas")
        for path in (ROOT / room).rglob("*.py")
    }
    reading = {name for path, name in modules.items() if opens_files(path)}
    assert len(reading) > 20
    assert sorted(reading - seen - NOT_ATTACKED.keys()) == []
    assert sorted(NOT_ATTACKED.keys() - reading) == [], "these open nothing any more"
