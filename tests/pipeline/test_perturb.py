"""`fidpipe perturb`: altered scans, repeating and resuming."""

import shutil

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from scipy.spatial import cKDTree

from fidpipe.pipeline.evaluate import evaluate_pair
from fidpipe.pipeline.jobs.scoring import score_pair
from fidpipe.pipeline.paper import perturb as experiment_module
from fidpipe.pipeline.paper.perturb import (
    PerturbRequest,
    choose_objects,
    parse_levels,
    perturb_source,
)
from fidpipe.pipeline.results.object_frame import SHAPES
from fidpipe.pipeline.results.status import run_status
from fidpipe.schemas.errors import RunError, SettingsError
from fidpipe.schemas.settings import load
from fidpipe.stages.generate.flaws import Perturbation, perturb
from fidpipe.stages.graph import build_graph
from runs import QUIET, command, contents, listening
from scenes import street, write_bin, write_dataset

SETTINGS = load(None, ["graph.k=12"])
LEVELS = parse_levels(["noise=0.01", "dropout=0.1,0.4", "rigid=0:1,0:2"])


#: A single level, once for each object.
ONCE = {"levels": LEVELS[:1], "repeats": 1, "global_repeats": 0}


def perturbed(
    source, out, *, settings=SETTINGS, reporter=QUIET, pattern=None, replace=False, **asked
):
    request = PerturbRequest(**{"levels": LEVELS, "repeats": 3, "global_repeats": 2} | asked)
    options = {"pattern": pattern, "n_workers": 1, "replace_finished": replace}
    return perturb_source(source, out, settings, reporter, request, **options)


def chosen(outcome):
    """The objects of the table, each once."""
    columns = ["pair_id", "community_id", "object", "n_points"]
    return outcome.tables["perturb_objects"].to_pandas()[columns].drop_duplicates()


def rows(out, table="perturb_objects"):
    return pd.read_parquet(out / f"{table}.parquet").sort_values(
        ["pair_id", "kind", "amount", "repeat"], ignore_index=True
    )


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return write_bin(tmp_path_factory.mktemp("scan") / "street.bin", street())


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    """A street with a label for each point, in a file that has a label column."""
    points = street()
    x, y, z = points.T
    label = np.select(
        [z < -1.55, (x > 0) & (y > 0), (x < 0) & (y > 0), x > -7],
        ["road", "car", "tree", "wall"],
        "pole",
    )
    path = tmp_path_factory.mktemp("labelled") / "street.parquet"
    pd.DataFrame({"x": x, "y": y, "z": z, "label": label}).to_parquet(path)
    return path


@pytest.fixture(scope="module")
def done(scan, tmp_path_factory):
    return perturbed(scan, tmp_path_factory.mktemp("perturb") / "run")


def test_rigid_rows_are_exact(done):
    of_scan = rows(done.folder, "perturb_global").query("kind == 'rigid'")
    assert (of_scan.match_rate == 1).all()
    assert of_scan.eigenspectrum_distance_mean.max() < 1e-5
    one, two = of_scan.groupby("amount").centroid_distance_m_mean.first()
    assert two / one == pytest.approx(2, rel=1e-3)
    objects = rows(done.folder).query("kind == 'rigid'")
    assert objects.r_lambda.max() < 0.01
    assert objects.r_gap.max() < 1e-4


def test_the_null_row_is_measured_under_another_order_and_another_louvain_seed(
    scan, tmp_path, monkeypatch
):
    seeds = []

    def watched(settings, tables):
        seeds.append(settings.communities.seed)
        return score_pair(settings, tables)

    monkeypatch.setattr("fidpipe.pipeline.paper.perturb.score_pair", watched)
    outcome = perturbed(
        scan,
        tmp_path / "run",
        levels=(*parse_levels(["null"]), *LEVELS[:1]),
        repeats=2,
        global_repeats=2,
    )
    assert not outcome.failures
    of_scan = rows(tmp_path / "run", "perturb_global")
    null = of_scan.query("kind == 'null'")
    assert (null.n_points - null.n_points_altered).tolist() == [1, 1]
    assert seeds == [*(null.seed % 2**31), SETTINGS.communities.seed, SETTINGS.communities.seed]
    assert rows(tmp_path / "run").query("kind == 'null'").r_lambda.notna().all()


def test_all_seeds_differ(done):
    seeds = np.concatenate(
        [rows(done.folder, table).seed for table in ("perturb_objects", "perturb_global")]
    )
    assert len(np.unique(seeds)) == len(seeds)


def test_an_object_is_rebuilt_from_its_points_alone(done, scan, tmp_path, monkeypatch):
    sizes = []
    monkeypatch.setattr(
        "fidpipe.stages.graph.build_graph",
        lambda points, settings: (sizes.append(len(points)), build_graph(points, settings))[1],
    )
    once = {"levels": parse_levels(["rigid=0:7"]), "repeats": 1, "global_repeats": 0}
    perturbed(scan, tmp_path / "run", **once)
    assert sizes[::2] == sizes[1::2]
    assert sorted(sizes[::2]) == sorted(chosen(done)["n_points"])


def test_a_finished_experiment_is_reused_and_another_request_replaces_it_only_if_asked(
    done, scan, tmp_path
):
    out = shutil.copytree(done.folder, tmp_path / "run")
    again = perturbed(scan, out)
    assert (again.n_made, again.n_reused) == (0, 1)
    assert again.tables.keys() == done.tables.keys()
    assert all(again.tables[name].equals(done.tables[name]) for name in done.tables)
    before = contents(out)
    for options, why in (
        (
            {"settings": load(None, ["graph.k=12", "graph.tau_m=0.3"])},
            r"graph\.tau_m was 0\.2, is 0\.3",
        ),
        ({"levels": LEVELS[1:]}, r"perturb\.levels was .*noise.*0\.01"),
        ({"seed": 1}, "seed was 0, is 1"),
    ):
        with pytest.raises(RunError, match=f"{why}.*--replace"):
            perturbed(scan, out, **options)
    assert contents(out) == before
    other = perturbed(scan, out, seed=1, replace=True)
    assert other.n_made == 1
    assert not other.tables["perturb_summary"].equals(done.tables["perturb_summary"])


def test_more_repeats_keep_the_rows_of_the_others(done, scan, tmp_path):
    perturbed(scan, tmp_path / "run", levels=(*LEVELS, Perturbation("noise", 0.1)), repeats=4)
    fewer, more = rows(done.folder), rows(tmp_path / "run")
    assert len(more.merge(fewer)) == len(fewer) < len(more)


def test_a_scan_with_a_damaged_file_is_evaluated_again(done, scan, tmp_path):
    out = shutil.copytree(done.folder, tmp_path / "run")
    (out / "perturb_global" / "street.parquet").write_bytes(b"PAR1")
    again = perturbed(scan, out)
    assert again.n_made == 1
    assert again.tables["perturb_summary"].equals(done.tables["perturb_summary"])


def test_an_interrupted_experiment_keeps_the_scans_that_are_done(tmp_path, monkeypatch):
    dataset = write_dataset(tmp_path / "data", 2)
    once = {"levels": LEVELS[:1], "repeats": 1, "global_repeats": 0, "pattern": "*"}
    seen = []

    def interrupted(*arguments):
        if seen:
            raise KeyboardInterrupt
        seen.append(arguments)
        return choose_objects(*arguments)

    monkeypatch.setattr(experiment_module, "choose_objects", interrupted)
    with pytest.raises(KeyboardInterrupt):
        perturbed(dataset, tmp_path / "run", **once)
    monkeypatch.undo()
    outcome = perturbed(dataset, tmp_path / "run", **once)
    assert (outcome.n_made, outcome.n_reused) == (1, 1)
    fresh = perturbed(dataset, tmp_path / "fresh", **once)
    assert outcome.tables["perturb_summary"].equals(fresh.tables["perturb_summary"])


def test_labelled_objects_are_the_classes_of_the_paper(labelled, tmp_path):
    outcome = perturbed(labelled, tmp_path / "run", **ONCE)
    assert sorted(chosen(outcome)["object"]) == ["car", "tree", "wall"]


@pytest.mark.parametrize(
    ("shapes", "expected"),
    [
        ([(0.2, 0.1, 0.7), (0.4, 0.5, 0.1), (0.3, 0.6, 0.1), (0.1, 0.7, 0.2)], [1, 2, 0]),
        ([(0.3, 0.1, 0.6), (0.4, 0.1, 0.5)], [1, 0]),
    ],
)
def test_no_object_stands_for_two_shapes(shapes, expected):
    objects = pd.DataFrame(shapes, columns=[*SHAPES])
    objects = objects.assign(n_points=99, range_m=1.0, label=None, label_share=1.0)
    assert list(choose_objects(objects, SETTINGS.graph.k)) == expected


def test_levels_that_agree_to_many_digits_are_two(scan, tmp_path):
    levels = parse_levels(["noise=0.01,0.0100000001"])
    outcome = perturbed(scan, tmp_path / "run", levels=levels, repeats=0, global_repeats=1)
    assert not outcome.failures
    assert rows(tmp_path / "run", "perturb_global").amount.tolist() == [0.01, 0.0100000001]


def test_without_labels_each_shape_has_an_object(done):
    assert sorted(chosen(done)["object"]) == ["linear", "planar", "scattered"]


def test_of_a_dataset_the_first_real_scan_is_taken_or_those_that_are_asked_for(tmp_path):
    dataset = write_dataset(tmp_path / "data")
    options = {"levels": LEVELS[:1], "repeats": 1, "global_repeats": 1}
    reporter, said = listening()
    first = perturbed(dataset, tmp_path / "one", reporter=reporter, **options)
    assert first.pairs == ["000"]
    assert "swapped" not in said.getvalue()  # the real scan is read on both sides
    outcome = perturbed(dataset, tmp_path / "two", pattern="00[12]", **options)
    assert outcome.pairs == ["001", "002"]
    (row,) = [
        row
        for row in outcome.tables["perturb_summary"].to_pylist()
        if row["metric"] == "match_rate"
    ]
    assert row["n"] == 2


def test_a_dataset_whose_first_pair_lacks_its_simulated_scan_is_perturbed(tmp_path):
    dataset = write_dataset(tmp_path / "data")
    (dataset / "sim" / "000.bin").unlink()
    options = {"levels": LEVELS[:1], "repeats": 0, "global_repeats": 1}
    outcome = perturbed(dataset, tmp_path / "run", **options)
    assert outcome.pairs == ["000"]
    assert not outcome.failures
    write_bin(dataset / "sim" / "000.bin", street())
    (dataset / "real" / "000.bin").unlink()
    assert "no partner" in perturbed(dataset, tmp_path / "run", **options).failures["000"]


def test_a_dropout_that_leaves_nothing_is_null_with_a_reason(scan, tmp_path):
    options = {
        "levels": (Perturbation("dropout", 1.0),),
        "repeats": 1,
        "global_repeats": 1,
    }
    settings = load(None, ["graph.k=12", "metrics.baselines=chamfer"])
    assert not perturbed(scan, tmp_path / "run", settings=settings, **options).failures
    for row in pd.read_parquet(tmp_path / "run" / "perturb_objects.parquet").to_dict("records"):
        assert np.isnan([row["r_lambda"], row["cdc"]]).all()
        assert (row["status"], row["n_points_altered"]) == ("too_small", 0)
        assert row["reason"].endswith("got 0")
    (row,) = pd.read_parquet(tmp_path / "run" / "perturb_global.parquet").to_dict("records")
    assert np.isnan(row["match_rate"])
    assert row["reason"].endswith("got 0")
    assert not len(pd.read_parquet(tmp_path / "run" / "perturb_baselines.parquet"))


@pytest.mark.parametrize(
    ("word", "fault"),
    [
        ("fog", "'fog'"),
        ("dropout=much", "'much'"),
        ("dropout=1.5", "dropout.*got '1.5'"),
        ("noise=0.1:2", "noise.*got '0.1:2'"),
        ("noise=nan", "noise.*got 'nan'"),
    ],
)
def test_a_wrong_level_is_one_line(word, fault):
    with pytest.raises(SettingsError, match=fault):
        parse_levels([word])


def test_the_folder_of_another_command_is_refused(done, scan, tmp_path):
    from runs import run

    dataset = write_dataset(tmp_path / "data", 1)
    run(dataset, tmp_path / "run", SETTINGS)
    with pytest.raises(RunError, match="^perturb .*: was written by fidpipe run"):
        perturbed(scan, tmp_path / "run")
    with pytest.raises(RunError, match="^run .*: was written by fidpipe perturb"):
        run(dataset, done.folder, SETTINGS)
    with pytest.raises(RunError, match="fidpipe perturb"):
        run_status(done.folder)


def test_baselines_are_swept_on_the_same_altered_objects(done, scan, tmp_path):
    out = tmp_path / "run"
    settings = load(None, ["graph.k=12", "metrics.baselines=chamfer,f_score"])
    outcome = perturbed(scan, out, settings=settings)
    assert rows(out).equals(rows(done.folder))
    baselines, objects = rows(out, "perturb_baselines"), rows(out)
    assert set(baselines.seed) == set(objects.seed)
    row = baselines.query("kind == 'noise' and baseline == 'chamfer_mean_m'").iloc[0]
    pair = evaluate_pair(scan, scan, settings)
    cloud = pair.points["real"].merge(pair.communities["real"])
    points = cloud.query(f"community_id == {row.community_id}")[["x", "y", "z"]].to_numpy()
    altered = perturb(points, Perturbation("noise", 0.01), np.random.default_rng(row.seed))
    there = cKDTree(altered).query(points)[0]
    back = cKDTree(points).query(altered)[0]
    assert row.value == pytest.approx(there.mean() + back.mean())
    summary = outcome.tables["perturb_summary"].to_pandas()
    means = summary.groupby(["metric", "kind"])["mean"].mean()
    assert means["f_score", "rigid"] < means["f_score", "dropout"]
    assert means["r_lambda", "rigid"] < 0.01 < means["r_lambda", "dropout"]


def test_the_command_prints_the_scores_of_the_whole_scan_and_draws_its_figure(scan, tmp_path):
    words = (
        "--workers",
        1,
        "--sweep",
        "noise",
        "--repeats",
        1,
        "--global-repeats",
        1,
        "--set",
        "graph.k=12",
    )
    result = command("perturb", scan, *words, cwd=tmp_path, code=0)
    assert "Whole scan, street" in result.stdout
    picture = imread(tmp_path / "runs" / "street-perturb" / "perturb.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 50


def test_a_curve_has_one_colour_in_all_panels_and_its_levels_as_ticks():
    from fidpipe.pipeline.paper.experiment_views import draw_panel
    from fidpipe.pipeline.report.figures.style import new_figure

    rows = [
        {"curve": curve, "amount": amount, "mean": 0.1, "std": 0.0}
        for curve, amounts in (("wall", (0.001, 0.1)), ("car", (0.01, 0.1)))
        for amount in amounts
    ]
    with new_figure(3, 3) as figure:
        axis = figure.subplots()
        draw_panel(axis, pd.DataFrame(rows), {"car": "red", "wall": "blue"})
        lines = {bars.get_label(): bars.lines[0].get_color() for bars in axis.containers}
        ticks = [tick.get_text() for tick in axis.get_xticklabels()]
    assert lines == {"car": "red", "wall": "blue"}
    assert ticks == ["0.001", "0.01", "0.1"]
