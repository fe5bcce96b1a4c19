"""Acceptance criteria: verdicts against the tables, exit codes, and files that CI reads."""

import json
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.report.views.gate_view import junit_xml
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.gate import Criterion, judge_run, parse_word, read_criteria
from fidpipe.pipeline.results.measures import Measures
from fidpipe.schemas.errors import SettingsError
from runs import command, copied, run
from scenes import write_dataset

N_PAIRS = 3


@pytest.fixture(scope="module")
def incomplete(scenario):
    return scenario("failed") / "run"


def judged(folder, *words):
    criteria = [parse_word(word.partition(" ")[2], word.partition(" ")[0]) for word in words]
    return {of.measure: of for of in judge_run(folder, criteria).judged}


def test_measures_are_the_numbers_of_the_tables(finished):
    measures = Measures(FinishedRun(finished))

    def of(name):
        return measures.named(name)[0]

    pairs = pd.read_parquet(finished / "pairs.parquet")
    metrics = pd.read_parquet(finished / "metrics")
    objects = pd.read_parquet(finished / "objects")
    matching = pd.read_parquet(finished / "matching")
    assert of("r_lambda.mean") == pytest.approx(pairs.r_lambda_mean.mean())
    assert of("match_rate.min") == pairs.match_rate.min()
    assert of("alignment_rms_m.std") == pytest.approx(pairs.alignment_rms_m_mean.std())
    assert of("objects.cdc.q95") == pytest.approx(metrics.cdc.quantile(0.95))
    assert of("objects.r_lambda.std") == pytest.approx(metrics.r_lambda.std())
    assert (of("objects.cdc.min"), of("cdc.max")) == (metrics.cdc.min(), pairs.cdc_mean.max())
    alone = matching[matching.status == "not_found"].merge(
        objects[objects.side == "real"],
        left_on=["pair_id", "real_id"],
        right_on=["pair_id", "community_id"],
    )
    assert of("not_found.total") == of("not_found") == len(alone) > 0
    assert of("not_found.max") == alone.groupby("pair_id").size().max()
    assert of("not_found.within_12m") == (alone.range_m < 12).sum()
    near = objects[(objects.side == "real") & (objects.range_m < 12)]
    assert of("not_found.within_12m.share") == pytest.approx(
        (alone.range_m < 12).sum() / len(near)
    )
    assert of("matched.mean") == pytest.approx(pairs.n_matched.mean())
    assert [of(f"pairs.{state}") for state in ("scored", "failed", "to_do", "changed")] == [
        3,
        0,
        0,
        0,
    ]


KNOWN = r"the nearest are ([\w.]+, ){14}[\w.]+"
UNKNOWN = [
    "r_lambda",
    "r_lambda.",
    "not_found.within_20",
    "objects.match_rate.mean",
    "x",
    "",
    "class.car.x",
    "pairs.x",
]


@pytest.mark.parametrize("name", [*UNKNOWN, "r_lamda.mean"])
def test_an_unknown_measure_is_named_with_those_that_are_known(finished, name):
    advice = (
        r"did you mean r_lambda\.mean\?"
        if name == "r_lamda.mean"
        else f"(did you mean|{KNOWN})"
    )
    with pytest.raises(SettingsError, match=advice):
        Measures(FinishedRun(finished)).named(name)


def test_bounds_are_inclusive(finished):
    value = Measures(FinishedRun(finished)).named("r_lambda.mean")[0]
    limits = {
        "a": ("max", value),
        "b": ("min", value),
        "c": ("max", value - 1e-9),
        "d": ("min", value + 1e-9),
    }
    result = judge_run(
        finished, [Criterion(name, "r_lambda.mean", *own) for name, own in limits.items()]
    )
    verdict = {of.name: of.passed for of in result.judged}
    assert [verdict[name] for name in limits] == [True, True, False, False]


def test_what_could_not_be_computed_fails_whatever_the_bound(finished):
    found = judged(
        finished, "max class.car.r_lambda.mean=1000", "min class.car.not_found.total=-1"
    )
    for of in (found["class.car.r_lambda.mean"], found["class.car.not_found.total"]):
        assert (of.value, of.passed) == (None, False)
        assert "could not be computed: no" in of.why


def test_a_run_with_failed_pairs_or_pairs_to_do_does_not_pass_silently(incomplete):
    found = judged(incomplete, "min match_rate.mean=0")
    assert (found["pairs.failed"].value, found["pairs.failed"].passed) == (1, False)
    assert (found["pairs.to_do"].value, found["pairs.to_do"].passed) == (1, False)
    allowed = judged(incomplete, "max pairs.failed=1", "max pairs.to_do=1")
    assert all(of.passed for of in allowed.values())


def test_scans_that_changed_since_the_run_fail_it(tmp_path):
    data = write_dataset(tmp_path / "streets", 2)
    run(data, tmp_path / "run")
    path = data / "sim" / "001.bin"
    path.write_bytes(path.read_bytes()[:-16])
    found = judged(tmp_path / "run", "min match_rate.mean=0")["pairs.changed"]
    assert (found.value, found.passed) == (1, False)
    data.rename(tmp_path / "elsewhere")
    result = judge_run(tmp_path / "run", [parse_word("match_rate.mean=0", "min")])
    assert result.passed
    assert "is not here: not checked whether it has changed" in result.notes[1]


def write_manifest(data, T_real_sim):
    rows = [
        f"{name},real/{name}.bin,sim/{name}.bin,{T}"
        for name, T in (("000", ""), ("001", T_real_sim))
    ]
    (data / "pairs.csv").write_text("\n".join(["pair_id,real,sim,T_real_sim", *rows]) + "\n")


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    """Two pairs with a manifest and labels for the first, and their run."""
    folder = tmp_path_factory.mktemp("labelled")
    data = write_dataset(folder / "streets", 2)
    n = (data / "real" / "000.bin").stat().st_size // 16
    np.full(n, 4, dtype="<u4").tofile(data / "real" / "000.label")
    (data / "labels.toml").write_text('4 = "tree"\n')
    write_manifest(data, "")
    run(data, folder / "run")
    return folder


@pytest.fixture
def moved(labelled, tmp_path):
    """A copy of the labelled dataset and its run, the run's record naming the copy."""
    copied(labelled / "streets", labelled / "run", tmp_path)
    return tmp_path


def changed(folder):
    return judged(folder / "run", "min match_rate.mean=0")["pairs.changed"]


def test_labels_their_names_and_T_real_sim_count_as_changes(moved):
    data = moved / "streets"
    assert (changed(moved).value, changed(moved).passed) == (0, True)
    criteria = judged(moved / "run", "max class.bus.cdc.mean=1")
    (why,) = [criterion.why for name, criterion in criteria.items() if "bus" in name]
    assert why == "could not be computed: no object has the class bus; classes are tree"
    write_manifest(data, "1 0 0 0.5 0 1 0 0 0 0 1 0")
    assert (changed(moved).value, changed(moved).passed) == (1, False)
    write_manifest(data, "")
    # of the pair with labels, not of the other
    (data / "labels.toml").write_text('4 = "car"\n')
    assert changed(moved).value == 1
    (data / "labels.toml").write_text('4 = "tree"\n')
    labels = data / "real" / "000.label"
    labels.write_bytes(b"\x05" + labels.read_bytes()[1:])
    assert changed(moved).value == 1
    labels.unlink()
    assert changed(moved).value == 1


def test_a_dataset_that_is_there_but_broken_fails_with_the_reason(moved):
    (moved / "streets" / "pairs.csv").write_text("pair_id,real\n")
    result = judge_run(moved / "run", [parse_word("match_rate.mean=0", "min")])
    found = {of.measure: of for of in result.judged}
    assert not any("is not here" in note for note in result.notes)
    for measure in ("pairs.changed", "pairs.to_do"):
        assert (found[measure].value, found[measure].passed) == (None, False)
        assert "missing columns sim" in found[measure].why


def test_a_min_does_not_switch_off_the_max_of_failed_pairs(incomplete):
    result = judge_run(incomplete, [parse_word("pairs.failed=0", "min")])
    found = {of.bound: of.passed for of in result.judged if of.measure == "pairs.failed"}
    assert found == {"max": False, "min": True}


def test_a_run_without_a_scored_pair_fails_with_files_for_ci(tmp_path):
    data = write_dataset(tmp_path / "streets", 1)
    (data / "sim" / "000.bin").write_bytes(b"")
    run(data, tmp_path / "run")
    measures = (
        "not_found.within_20m",
        "objects.cdc.mean",
        "class.car.not_found.total",
        "cdc.mean",
    )
    words = [word for measure in measures for word in ("--max", f"{measure}=1")]
    command("gate", tmp_path / "run", *words, code=4)
    assert (tmp_path / "run" / "gate.xml").exists()
    found = json.loads((tmp_path / "run" / "gate.json").read_text())["criteria"]
    why = {of["measure"]: of["why"] for of in found if of["measure"] in measures}
    assert all("could not be computed: no pair" in why[measure] for measure in measures)


def test_the_command_exits_with_zero_or_four_and_writes_what_ci_reads(again, tmp_path):
    good = command(
        "gate", again, "--max", "r_lambda.mean=1", "--min", "match_rate.mean=0", code=0
    )
    assert "all criteria are met" in good.stdout
    bad = command(
        "gate",
        again,
        "--max",
        "r_lambda.mean=0",
        "--out",
        tmp_path,
        code=4,
    )
    assert "FAIL" in bad.stdout
    assert json.loads((again / "gate.json").read_text())["passed"] is True
    found = json.loads((tmp_path / "gate.json").read_text())
    assert found["passed"] is False
    suite = ElementTree.parse(tmp_path / "gate.xml").getroot().find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == ("5", "1")
    failure = suite.find("testcase[@name='r_lambda.mean <= 0']/failure")
    assert "<= 0" in failure.get("message")


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--max", "nose=1"], "nose"),
        (["--max", "r_lambda.mean"], "r_lambda.mean"),
        (["--max", "r_lambda.mean=nan"], "r_lambda.mean"),
        (["--min", "r_lambda.mean=much"], "r_lambda.mean"),
        (["--criteria", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_a_wrong_criterion_ends_with_one_line_and_no_files(again, words, fault):
    result = command("gate", again, *words, code=1)
    assert fault in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (again / "gate.xml").exists()


def test_a_file_of_criteria_gives_names_and_reasons(tmp_path):
    path = tmp_path / "acceptance.toml"
    path.write_text(
        '[[criterion]]\nname = "structure"\nmeasure = "r_lambda.mean"\n'
        'max = 0.4\nmin = 0.1\nreason = "as the last build"\n'
    )
    assert read_criteria(path) == [
        Criterion("structure", "r_lambda.mean", "max", 0.4, "as the last build"),
        Criterion("structure", "r_lambda.mean", "min", 0.1, "as the last build"),
    ]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "criterion"),
        ('[[criterion]]\nname = "a"\nmeasure = "cdc.mean"\nmax = 1\n', "criterion.0.reason"),
        (
            '[[criterion]]\nname = "a"\nmeasure = "cdc.mean"\nreason = "b"\n',
            "expected max or min",
        ),
        (
            '[[criterion]]\nname = "a"\nmeasure = "cdc.mean"\nreason = "b"\nmax = nan\n',
            "criterion.0.max",
        ),
        (
            '[[criterion]]\nname = "a"\nmeasure = "cdc.mean"\nreason = "b"\nmaximum = 1\n',
            "criterion.0.maximum",
        ),
        ("= 1", "not valid TOML"),
    ],
)
def test_a_wrong_file_of_criteria_is_named_with_the_field(tmp_path, text, fault):
    path = tmp_path / "acceptance.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=fault):
        read_criteria(path)


def test_names_that_xml_cannot_hold_still_give_xml(finished):
    name = "a\x00b\x1b[31m<script>&\"'雨"
    result = judge_run(finished, [Criterion(name, "class.<b>\x07.cdc.mean", "max", 1, "]]>")])
    root = ElementTree.fromstring(junit_xml("gate", {"a": result.judged}))
    cases = [case.get("name") for case in root.iter("testcase")]
    assert cases[-1] == "a\\u0000b\\u001b[31m<script>&\"'雨"
