"""What is attacked: readers of scans and recordings, and of all else that fidpipe reads from disk."""

import json
import shutil
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import tomli_w

from recordings import cloud, write_bag
from seeds import _ROWS, SCANS, Target, files_written, scan_files


def _label_names():
    return [{**scan_files(), "labels.toml": b'# names\n1 = "car"\n4 = "tree"\n40 = \'road\'\n'}]


def _manifests():
    identity = "1 0 0 0 0 1 0 0 0 0 1 0"
    head = "pair_id,real,sim,timestamp_s,T_real_sim,T_world_sensor\n"
    rows = "".join(f"{i},real/{i}.bin,sim/{i}.bin,{i}.5,{identity},{identity}\n" for i in range(3))
    plain = 'pair_id, real, sim\na,real/0.bin,sim/0.bin\n"b, c",real/1.bin#0,real/drive.mcap#/points@1.5\n'
    return [{**scan_files(), "pairs.csv": text.encode()} for text in (head + rows, plain)]


def _dataset(folder):
    from fidpipe.pipeline.datasets.pairs import read_dataset
    from fidpipe.pipeline.datasets.readers.frame_address import address_of
    from fidpipe.pipeline.storage.table_files import table_name

    dataset = read_dataset(folder)
    for pair in dataset.pairs:
        name = table_name("metrics", pair.pair_id)
        if (folder / name).parent != folder / "metrics" or "\0" in name or len(Path(name).name.encode()) > 200:
            raise RuntimeError(f"pair {pair.pair_id!r} is written to {name!r}")
        for path in filter(None, (pair.real, pair.sim)):
            address_of(path)
    return dataset


def _poses():
    numbers = "".join(f"{i}.5 1 2 3 0 0 0 1\n" for i in range(3))
    kitti = "1 0 0 0 0 1 0 0 0 0 1 0\n" * 3
    scans = scan_files()
    return [
        {**scans, "pose/poses.tum": f"# time\n{numbers}".encode()},
        {**scans, "pose/poses.txt": kitti.encode(), "pose/calib.txt": b"P0: 1\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n"},
        {**scans, "pose/times.txt": b"0.5\n1.5\n2.5\n"},
    ]


def _posed(folder):
    from fidpipe.pipeline.datasets.pairing import read_timeline
    from fidpipe.pipeline.generate.recordings import read_recording

    for path in (folder / "pose").iterdir():
        shutil.copy(path, folder / "real" / path.name)
    if (folder / "real" / "times.txt").exists():
        return read_timeline(folder / "real")
    return read_recording(folder / "real")


def _settings():
    from fidpipe.schemas.settings import PRESETS, parse
    from fidpipe.schemas.settings_text import to_toml

    return [{"a.toml": to_toml(parse({"preset": name})).encode()} for name in PRESETS]


def _load_settings(folder):
    from fidpipe.schemas.settings import load, overrides
    from fidpipe.schemas.settings_text import to_toml

    settings = load(folder / "a.toml")
    return overrides(settings), to_toml(settings)


def _criteria():
    one = '[[criterion]]\nname = "structure"\nmeasure = "r_lambda.mean"\nmax = 0.4\nreason = "agreed"\n\n'
    two = '[[criterion]]\nname = "found"\nmeasure = "match_rate.min"\nmin = 0.5\nmax = 1\nreason = "also"\n'
    return [{"a.toml": one.encode()}, {"a.toml": (one + two).encode()}]


def _read_criteria(folder):
    from fidpipe.pipeline.results.gate import read_criteria

    return read_criteria(folder / "a.toml")


def _run_folder():
    """A small finished run."""
    from runs import run
    from scenes import write_dataset

    def write(folder):
        run(write_dataset(folder / "data", 1, n=20), folder / "run")
        shutil.rmtree(folder / "data")

    return [{name: content for name, content in files_written(write).items() if not name.endswith(".lock")}]


def _open_run(folder):
    """What a run shows of itself; then its ledger made again from the footers of its tables."""
    from fidpipe.pipeline.results.finished import FinishedRun, pair_facts, run_facts
    from fidpipe.pipeline.results.measures import Measures
    from fidpipe.pipeline.storage.folder import RunFolder
    from fidpipe.pipeline.storage.ledger import LEDGER

    try:
        finished = FinishedRun(folder / "run")
        run_facts(finished)
        for row in finished.scored:
            pair_facts(finished, row["pair_id"])
        Measures(finished).named("objects.cdc.q95")
    finally:
        (folder / "run" / LEDGER).unlink()
        jobs = RunFolder(folder / "run").ledger.jobs("000")
    return jobs


def _sensors():
    rows = "".join(f"{10 - i},{i % 2}\n" for i in range(8))
    lists = "elevation_deg = [2.0, 0.0, -2]\nazimuth_offset_deg = [0, 0.5, 0]\nrange_noise_m = 0.02\n"
    uniform = "channels = 32\nupper_deg = 15\nlower_deg = -25.0\nmin_range_m = 1\nmax_range_m = 90\nlost_share = 0.1\n"
    tables = {"a.csv": f"elevation_deg,azimuth_offset_deg\n{rows}", "a.toml": lists}
    return [{name: text.encode()} for name, text in (*tables.items(), ("a.toml", uniform))]


def _read_sensor(folder):
    from fidpipe.pipeline.generate.sensor_files import read_sensor

    (path,) = folder.glob("a.*")
    return read_sensor(str(path))


def _recipes():
    """What `synth`, `twin` and `floor` wrote of how they made a folder; the other file says which of them."""
    from fidpipe.pipeline.generate.synth import recipe_of
    from fidpipe.pipeline.results.floor import FloorRecipe

    twin = 'version = 1\nseed = 0\ninputs_sha256 = "00"\nfiles = ["0.bin", "0.label"]\n[sensor]\nname = "x"\n'
    floor = FloorRecipe(1, "again", 0.02, 0.05, 0, "streets").to_toml()
    texts = {"synth": tomli_w.dumps(recipe_of(0, "vlp32c", None)), "twin": twin, "floor": floor}
    return [{"a.toml": text.encode(), "kind": kind.encode()} for kind, text in texts.items()]


def _go_on(folder):
    """Prepares to go on in a folder of this recipe: with what another recipe left there, and then in its place."""
    from fidpipe.pipeline.generate import floor_run, synth, twin
    from fidpipe.pipeline.generate.dataset_folder import prepare_folder
    from fidpipe.pipeline.generate.recordings import Recording
    from fidpipe.pipeline.results.floor import FLOOR_DATASET, FloorRecipe, read_recipe
    from fidpipe.schemas.errors import FidpipeError

    out, kind = folder / "out", (folder / "kind").read_text()
    place = out / (FLOOR_DATASET if kind == "floor" else ".")
    for side in ("real", "sim"):
        (place / side).mkdir(parents=True)
    shutil.copy(folder / "a.toml", place / f"{kind}.toml")
    (place / "pairs.csv").write_text("pair_id,real,sim\n")
    if kind == "floor":
        if (recipe := read_recipe(out)) is None:
            raise FidpipeError("no recipe")
        wanted = FloorRecipe(1, "again", 0.02, 0.05, 0, "streets")
        return floor_run._refuse_other_recipe(out, wanted, replace=False), recipe.words
    recording = Recording(folder / "posed", folder / "poses.txt", (), {4: "tree"})

    def prepare(replace):
        if kind == "synth":
            owned, recipe = synth._own_files, synth.recipe_of(0, "vlp32c", None)
        else:
            owned, recipe = twin._own_files, twin._inputs(recording) | {"seed": 0, "files": []}
        prepare_folder(out, f"{kind}.toml", recipe, owned, set(), {}, replace=replace)

    with suppress(FidpipeError):
        prepare(replace=False)
    return prepare(replace=True)


def _gate_json():
    one = {"name": "structure", "measure": "r_lambda.mean", "bound": "max", "limit": 0.4, "reason": "agreed"}
    return [{"a.json": json.dumps({"criteria": [one], "verdicts": []}).encode()}]


def _read_gate_json(folder):
    from fidpipe.pipeline.report.page.run_data import _last_criteria
    from fidpipe.schemas.errors import FidpipeError

    if (criteria := _last_criteria(folder / "a.json")) is None:
        raise FidpipeError("no criteria")
    return criteria


_RECORD = SimpleNamespace(inputs={}, settings={}, stages={})


def _diagnoses():
    from fidpipe.pipeline.results.diagnosis import results_identity

    fields = {"floor": None, "n_pairs": 1, "n_blocks": 1, "over": "pairs", "distance_m": 0.1, "floor_m": 0.0}
    fields |= {"of": results_identity(_RECORD), "unexplained": 0.5, "causes": [], "estimates": [], "left_out": []}
    return [{"diagnosis.json": json.dumps(fields).encode()}]


def _read_diagnosis(folder):
    from fidpipe.pipeline.results.diagnosis import read_diagnosis
    from fidpipe.schemas.errors import FidpipeError

    if (found := read_diagnosis(folder, _RECORD)) is None:
        raise FidpipeError("no diagnosis")
    return found


def _records():
    return [{"run.json": json.dumps({"inputs": {"000": {}, "a b": {}}, "stages": {"graph": {}}}).encode()}]


def _complete(folder):
    from fidpipe.pipeline.cli import completion
    from fidpipe.schemas.errors import FidpipeError

    context = SimpleNamespace(params={"run": folder, "out": folder}, args=[])
    if not completion.pairs(context, "") + completion.stages(context, ""):
        raise FidpipeError("no names")


def _exported():
    message = [("/fidpipe/points", 10**9, lambda types: cloud(types, _ROWS))]
    files = files_written(lambda folder: write_bag(folder / "a_mcap", message))
    return [{"a.mcap": files["a_mcap/a_mcap.mcap"]}]


def _in_the_way(folder):
    from fidpipe.pipeline.exchange.export import _is_ours
    from fidpipe.schemas.errors import FidpipeError

    if not _is_ours(folder / "a.mcap"):
        raise FidpipeError("not from fidpipe export")


#: By name: `SCANS`, and what fidpipe reads besides; of these `hot` says which of the files.
TARGETS = SCANS | {
    "labels.toml": Target(_label_names, _dataset, hot="labels", words=(b'"\\ud800"', b"1.5 = ", b"[a.b]", b"[[1]]")),
    "pairs.csv": Target(_manifests, _dataset, hot="pairs", words=(b"real/../../x", b"#/points@1", b"pair_id", b"CON")),
    "poses and times": Target(_poses, _posed, hot="pose/", words=(b"Tr: ", b"#", b"1_0", b"nan")),
    "settings": Target(_settings, _load_settings, words=(b"[a]\n", b"preset = 5\n", b"[[graph]]\n", b"graph = 1\n")),
    "run folder": Target(_run_folder, _open_run, hot="run/", words=(b"../", b"metrics/000.parquet", b"null", b"[]")),
    "criteria": Target(_criteria, _read_criteria, words=(b"[[criterion]]\n", b"[criterion]\n", b"max = nan\n")),
    "sensor table": Target(_sensors, _read_sensor, words=(b"channels = ", b"[a]\n", b"elevation_deg", b"[[1]]")),
    "recipe": Target(_recipes, _go_on, words=(b"[files]\n", b'"../x"', b'".."', b"[[seed]]\n", b'"\\u0000"', b"nan")),
    "diagnosis.json": Target(_diagnoses, _read_diagnosis, hot="diagnosis", words=(b"NaN", b"[[[[", b"null", b"1e999")),
    "gate.json": Target(_gate_json, _read_gate_json, words=(b"NaN", b"[[[[", b'{"a":', b"null", b"1e999")),
    "names at Tab": Target(_records, _complete, hot="run", words=(b"[[[[", b"null", b'{"inputs": [5]}', b"\x00")),
    "file in the way": Target(_exported, _in_the_way, words=SCANS["mcap"].words),
}
