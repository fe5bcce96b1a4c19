import io
import json
import shutil

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from rich.console import Console

import fidpipe
from fidpipe.pipeline.engine.schedule import Policy
from fidpipe.pipeline.report.render import terminal
from fidpipe.pipeline.report.views.run_view import seeds_view
from fidpipe.pipeline.results.status import run_status
from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.metrics import SEEDED_SCORES
from fidpipe.schemas.record import SeedSummary
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import SEEDS
from runs import JOBS_PER_PAIR, assert_same_tables, changed_files, command, marks, run, run_twice

THREE = load(None, ["stability.seeds=3"])


@pytest.fixture(scope="module")
def both(dataset, tmp_path_factory):
    return run_twice(dataset, tmp_path_factory, THREE)


@pytest.fixture(scope="module")
def plain(both):
    return both[0]


@pytest.fixture(scope="module")
def repeated(both):
    """The plain run, to which the seeds were added later."""
    return both[1:]


@pytest.fixture
def again(repeated, tmp_path):
    return shutil.copytree(repeated[0], tmp_path / "run")


def seeds(out):
    return {path.stem: pq.read_table(path) for path in sorted((out / "seeds").glob("*.parquet"))}


def test_the_main_tables_stay_those_of_the_set_seed(plain, repeated):
    out, outcome = repeated
    assert (outcome.n_made, outcome.n_reused) == (2, 28)
    assert not changed_files(out, marks(plain))
    assert_same_tables(out, plain)
    assert not (plain / "seeds").exists()


def test_each_row_is_what_a_run_under_that_seed_gives(dataset, repeated, tmp_path):
    tables = {pair_id: table.to_pandas().set_index("seed") for pair_id, table in seeds(repeated[0]).items()}
    assert list(tables) == ["000", "001"]
    for seed in range(3):
        for row in run(dataset, tmp_path / str(seed), load(None, [f"communities.seed={seed}"])).rows:
            found = tables[row["pair_id"]].loc[seed]
            assert {name: found[name] for name in SEEDED_SCORES} == {name: row[name] for name in SEEDED_SCORES}
    assert any(table.r_lambda_mean.nunique() > 1 for table in tables.values())


def test_the_table_has_a_row_a_seed_from_the_set_one_on(dataset, tmp_path):
    run(dataset, tmp_path / "run", load(None, ["stability.seeds=2", "communities.seed=7"]), pattern="000")
    (table,) = seeds(tmp_path / "run").values()
    assert SEEDS.check(table.cast(SEEDS.schema))["seed"].to_pylist() == [7, 8]


def test_a_second_run_makes_nothing_and_more_seeds_only_their_table(again, dataset):
    assert run(dataset, again, THREE).n_made == 0
    assert run_status(again).stages["seeds"] == {"done": 2}
    before, main = seeds(again), marks(again)
    assert run(dataset, again, load(None, ["stability.seeds=4"])).n_made == 2
    assert not changed_files(again, main)
    assert all(table.slice(0, 3).equals(before[pair_id]) for pair_id, table in seeds(again).items())


def test_they_stay_while_they_are_true_and_go_when_the_results_change(again, dataset):
    before = seeds(again)
    assert run(dataset, again).n_made == 0
    assert all(table.equals(before[pair_id]) for pair_id, table in seeds(again).items())
    run(dataset, again, load(None, ["selection.t=2"]))
    assert not seeds(again)


def test_the_record_holds_the_spread_over_seeds_and_pairs(repeated):
    out, outcome = repeated
    record = json.loads((out / "run.json").read_text())["seeds"]
    assert record == outcome.record.as_dict()["seeds"]
    by_pair = pd.read_parquet(out / "seeds").groupby("pair_id")
    assert (record["n_seeds"], record["n_pairs"]) == (3, 2)
    for name in SEEDED_SCORES:
        of, mean, std = record["dataset"][name], by_pair[name].mean(), by_pair[name].std()
        assert (of["mean"], of["std_pairs"]) == (pytest.approx(mean.mean()), pytest.approx(mean.std()))
        assert of["std_seeds"] == pytest.approx(np.sqrt((std**2).mean()))
        assert record["pairs"]["000"][name] == {"mean": pytest.approx(mean["000"]), "std": pytest.approx(std["000"])}


def test_python_gives_the_same_numbers_as_the_command(repeated, dataset):
    scans = [
        np.fromfile(dataset / side / "001.bin", dtype="<f4").reshape(-1, 4)[:, :3].astype(float)
        for side in ("real", "sim")
    ]
    found = fidpipe.evaluate_pair(*scans, settings=THREE).seeds
    written = seeds(repeated[0])["001"].to_pandas()
    pd.testing.assert_frame_equal(found.drop(columns="pair_id"), written.drop(columns="pair_id"), check_exact=True)


@pytest.mark.exhaustive
def test_two_workers_give_the_same_table(dataset, repeated, tmp_path):
    run(dataset, tmp_path / "run", THREE, workers=2, policy=Policy(worth_splitting_s=0.0))
    assert_same_tables(tmp_path / "run", repeated[0])
    found, wanted = seeds(tmp_path / "run"), seeds(repeated[0])
    assert found.keys() == wanted.keys()
    assert all(found[name].equals(wanted[name]) for name in found)


def test_the_terminal_shows_the_spread(repeated):
    shown = io.StringIO()
    Console(width=80, file=shown).print(
        terminal(seeds_view(SeedSummary.from_dict(repeated[1].record.as_dict()["seeds"])))
    )
    text = shown.getvalue()
    assert "How stable the scores are (3 seeds, 2 pairs)" in text
    for word in ("match rate", "r_lambda", "repeatability limit", "000", "001"):
        assert word in text


def test_the_option_is_the_setting(again, dataset):
    done = command("run", dataset, "--out", again, "--workers", 1, "--seeds", 3)
    assert done.returncode == 0, done.stderr
    assert f"0 jobs done, {2 * (JOBS_PER_PAIR + 1)} reused" in done.stdout
    assert "How stable the scores are (3 seeds, 2 pairs)" in done.stdout


def test_seeds_beyond_the_largest_are_refused():
    with pytest.raises(SettingsError, match="the last of stability.seeds is 2147483648"):
        load(None, [f"communities.seed={2**31 - 2}", "stability.seeds=3"])
