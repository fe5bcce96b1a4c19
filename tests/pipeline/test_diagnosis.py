"""`fidpipe diagnose`: a known flaw is the first cause, of the stored diagnosis, of show and of compare."""

import json
import shutil

import numpy as np
import pytest

from fidpipe.pipeline.diagnose.diagnose import diagnose_run
from fidpipe.pipeline.report.page.run_data import page_data
from fidpipe.pipeline.report.run_frames import read_results
from fidpipe.pipeline.results.compare import compare_runs
from fidpipe.pipeline.results.diagnosis import DIAGNOSIS
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.results import Diagnosis
from fidpipe.schemas.settings import load
from fidpipe.stages.diagnose.gain import Shares
from runs import command, run
from scenes import write_bin

TOO_LOW_M = 0.15


def corner(seed):
    """A road between two walls with a box, sampled at random."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-15, 15, (2, 2500))
    z = rng.uniform(-1.5, 2, 2500)
    road = np.column_stack([x, y / 3, np.full(2500, -1.5)])
    walls = np.column_stack([x, np.where(y > 0, 5.0, -5.0), z])[:1500]
    end = np.column_stack([np.full(1500, 12.0), y[:1500] / 3, z[:1500]])
    return np.vstack([road, walls, end])


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory):
    """Runs of a simulator as it should be, and of one that is mounted too high."""
    folder = tmp_path_factory.mktemp("diagnose")
    for name, low_m in (("good", 0.0), ("low", TOO_LOW_M)):
        for i in range(3):
            write_bin(folder / name / "real" / f"{i}.bin", corner(i))
            write_bin(folder / name / "sim" / f"{i}.bin", corner(i + 10) - [0, 0, low_m])
        run(folder / name, folder / f"run-{name}", load(None, ["graph.k=10"], preset="reference"))
    return folder


@pytest.fixture
def runs(two_runs, tmp_path):
    return [shutil.copytree(two_runs / f"run-{name}", tmp_path / name) for name in ("good", "low")]


def test_the_flaw_is_the_first_cause_everywhere(runs):
    good, low = runs
    shown = command("diagnose", low, "--floor", good, "--json")
    assert shown.returncode == 0, shown.stderr
    found = Diagnosis.from_dict(json.loads(shown.stdout))
    first = found.causes[0]
    assert first.name == "height"
    assert first.estimate == pytest.approx(-TOO_LOW_M, abs=0.02)
    assert first.low < first.estimate < first.high
    assert 0.8 < first.gain <= 1.05
    assert found.unexplained < 0.2
    curves = first.evidence
    peaks = {name: curves.x[int(np.argmax(getattr(curves, name)))] for name in ("sim", "corrected")}
    assert peaks["sim"] == pytest.approx(-TOO_LOW_M, abs=0.02), "the road lies behind the real one"
    assert peaks["corrected"] == pytest.approx(0.0, abs=0.02)
    chart = page_data(read_results(low))["charts"]["cause_height"]
    assert [curve["name"] for curve in chart["data"]] == ["simulated", "corrected"]
    assert json.loads((low / DIAGNOSIS).read_text()) == json.loads(shown.stdout)
    assert "world 15 cm too low" in command("show", low).stdout
    assert "world 15 cm too low" in command("diagnose", low, "--floor", good, "--markdown").stdout
    assert "height" not in {cause.name for cause in diagnose_run(good).causes}
    changes = compare_runs([good, low], independent=True)[0].causes
    assert changes[0].name == "height"


def test_what_no_correction_removes_is_the_first_cause_and_unsupported_causes_are_left_out(runs, monkeypatch):
    good, low = runs
    monkeypatch.setattr(
        "fidpipe.pipeline.diagnose.diagnose.shares",
        lambda scans, made, rng, floor_m: Shares(0.3, 0.3, floor_m, dict.fromkeys(made, 0.0)),
    )
    found = diagnose_run(low, good)
    assert [cause.name for cause in found.causes] == ["unexplained"]
    assert found.causes[0].estimate == pytest.approx(0.3 - found.floor_m)
    assert found.unexplained == 1
    assert "world 15 cm too low" in found.doubtful
    assert "no cause in the catalogue for 100 % of the distance" in command("show", low).stdout
    assert [cause.name for cause in diagnose_run(low).causes] == ["unexplained"]
    alone = "no cause in the catalogue for 100 % of the distance, unless a second measurement has it too (--floor)"
    assert alone in FinishedRun(low).overview.causes[0].words
    stored = json.loads((low / DIAGNOSIS).read_text())
    stored["causes"].append(stored["causes"][0] | {"name": "height"})
    (low / DIAGNOSIS).write_text(json.dumps(stored))
    names = [cause.name for cause in FinishedRun(low).overview.causes[:2]]
    assert names == ["height", "unexplained"], "what can be fixed comes first"


def test_a_diagnosis_of_other_results_is_not_used(runs):
    good, low = runs
    diagnose_run(low, good)
    assert FinishedRun(low).overview.causes[0].detail.startswith("gain")
    stored = json.loads((low / DIAGNOSIS).read_text())
    (low / DIAGNOSIS).write_text(json.dumps(stored | {"of": "another run"}))
    assert FinishedRun(low).overview == FinishedRun(low).record.overview


def test_a_part_of_the_pairs_is_diagnosed_but_not_stored(runs):
    _, low = runs
    assert diagnose_run(low, pattern="1").n_pairs == 1
    assert not (low / DIAGNOSIS).exists()


def test_a_floor_of_other_pairs_is_rejected(runs, scenario):
    with pytest.raises(RunError, match="expected the pairs of"):
        diagnose_run(runs[0], scenario("labelled") / "run")
