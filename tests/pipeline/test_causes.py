"""One list of causes: a simulator with known flaws, read from every command; and the rules that name causes."""

import json
import re

import numpy as np
import pytest

from fidpipe import evaluate_pair, open_run
from fidpipe.pipeline.inspect.check_view import check_view
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.pipeline.report.page.run_page import write_report
from fidpipe.pipeline.report.views.answer_view import amount_words
from fidpipe.pipeline.results.causes import (
    cause_interval,
    cause_values,
    changed_causes,
    interval_words,
    named_and_small,
    named_causes,
    no_cause_words,
    unknown_causes,
)
from fidpipe.schemas.cause_catalogue import CAUSES, FLAT, PARAMETERS, UNEVEN
from fidpipe.schemas.results import Unknown
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import load
from fidpipe.stages.generate.street_scans import make_pair
from reports import text_of
from runs import command
from scenes import write_bin

N_PAIRS = 3
TOO_LOW_M, NOISE_M, LOST = 0.12, 0.08, 0.25
FLAWS = ["height", "lost returns", "missing parts", "range noise"]


def re_measured(scan, rng, noise_m, lost_share, shift_z_m=0.0):
    """The same scan with noise along the ray and lost points, moved in z."""
    kept = scan[rng.random(len(scan)) >= lost_share]
    range_m = np.linalg.norm(kept, axis=1, keepdims=True)
    return kept * (1 + rng.normal(0, noise_m, (len(kept), 1)) / range_m) + [0, 0, shift_z_m]


def with_a_hole(scan):
    """The scan without near surface above the road, counterclockwise from ahead, until 6 % of its points are gone."""
    azimuth_deg = np.degrees(np.arctan2(scan[:, 1], scan[:, 0])) % 360
    rows = np.flatnonzero((scan[:, 2] > -1.4) & (np.linalg.norm(scan, axis=1) < 15))
    rows = rows[np.argsort(azimuth_deg[rows])]
    return np.delete(scan, rows[: len(scan) * 6 // 100], axis=0)


def flawed(scan, rng):
    return re_measured(with_a_hole(scan), rng, NOISE_M, LOST, -TOO_LOW_M)


def healthy(scan, rng):
    return re_measured(scan, rng, 0.01, 0.03)


def write_streets(folder, simulate):
    rng = np.random.default_rng(1)
    for seed in range(N_PAIRS):
        scan = make_pair(seed, 0, SENSORS["hdl64"], 30_000).real.rows[:, :3]
        write_bin(folder / "real" / f"{seed}.bin", scan)
        write_bin(folder / "sim" / f"{seed}.bin", simulate(scan, rng))
    return folder


@pytest.fixture(scope="module")
def streets(tmp_path_factory):
    return write_streets(tmp_path_factory.mktemp("causes") / "streets", flawed)


@pytest.fixture(scope="module")
def folder(streets):
    """The run of the flawed simulator, diagnosed."""
    out = streets.with_name("run")
    command("run", streets, "--out", out, "--preset", "reference", "--workers", 1, code=0)
    return out


@pytest.fixture(scope="module")
def named(folder):
    """The causes of the run before it is diagnosed, by name."""
    return {cause.name: cause for cause in open_run(folder).record.overview.causes}


def numbers(cause):
    """What every command has to agree on."""
    return [cause[name] for name in ("name", "words", "estimate", "low", "high", "setting")]


def test_the_flaws_are_named_with_their_amounts(named):
    assert sorted(named) == FLAWS
    assert named["height"].estimate == pytest.approx(-TOO_LOW_M, abs=0.01)
    assert named["range noise"].sim == pytest.approx(
        np.hypot(named["range noise"].real, NOISE_M), rel=0.1
    )
    assert named["lost returns"].estimate == pytest.approx(LOST, abs=0.03)
    assert named["missing parts"].kind == "world"
    for cause in named.values():
        assert cause.low < cause.estimate < cause.high
        assert cause.setting == CAUSES[cause.name].setting


def test_every_command_shows_the_same_causes(streets, folder, named, tmp_path):
    expected = sorted(numbers(cause.as_dict()) for cause in named.values())
    diagnosis = json.loads(command("diagnose", folder, "--workers", 1, "--json", code=0).stdout)
    run_ = open_run(folder)
    assert sorted(numbers(cause) for cause in diagnosis["causes"]) == expected
    assert diagnosis["doubtful"] == []
    assert diagnosis["unexplained"] < 0.3
    gains = [cause["gain_m"] for cause in diagnosis["causes"]]
    assert gains == sorted(gains, reverse=True)
    assert [cause.name for cause in run_.overview.causes] == [
        cause["name"] for cause in diagnosis["causes"]
    ]
    assert (
        sorted(
            run_.causes[["name", "words", "estimate", "low", "high", "setting"]]
            .to_numpy()
            .tolist()
        )
        == expected
    )

    check = check_dataset(streets, load(None, [], preset="reference"))
    assert sorted(numbers(cause.as_dict()) for cause in check.causes) == expected
    assert sum(bool(pair.causes) for pair in check.pairs) == 3

    command("run", streets, "--out", folder, "--preset", "reference", "--workers", 1, code=0)
    write_report(folder, html=tmp_path / "report.html")
    page = re.sub(r"\s+", " ", (tmp_path / "report.html").read_text())
    shown = {
        "run": command(
            "run", streets, "--out", folder, "--preset", "reference", "--workers", 1
        ).stdout,
        "show": command("show", folder).stdout,
        "diagnose": command("diagnose", folder, "--workers", 1).stdout,
        "check": text_of(check_view(check)),
    }
    for cause in run_.overview.causes:
        for text in shown.values():
            assert cause.words in " ".join(text.split())
            assert interval_words(cause) in " ".join(text.split())
        assert f"{cause.words}</strong>" in page
        assert amount_words(cause) in page
    for text in (shown["run"], shown["show"], shown["diagnose"], page):
        assert "unexplained: " in text.lower()
    assert "gain " in shown["run"]


def blind(scan, rng):
    azimuth_deg = np.degrees(np.arctan2(scan[:, 1], scan[:, 0]))
    return healthy(scan[(azimuth_deg < 100) | (azimuth_deg > 157)], rng)


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """The run of a simulator without flaws on the same real scans."""
    place = tmp_path_factory.mktemp("base")
    write_streets(place / "streets", healthy)
    command(
        "run",
        place / "streets",
        "--out",
        place / "run",
        "--preset",
        "reference",
        "--workers",
        1,
        code=0,
    )
    return place / "run"


def test_compare_decides_by_the_causes_of_the_sensor(base, folder, named):
    (comparison,) = json.loads(command("compare", base, folder, "--json", code=0).stdout)
    causes = {cause["name"]: cause for cause in comparison["causes"]}
    assert comparison["decision"] == "worse"
    for name in ("height", "range noise", "lost returns"):
        assert causes[name]["verdict"] == "worse"
        assert causes[name]["after"] == pytest.approx(
            named[name].estimate, abs=CAUSES[name].resolution
        )
    assert causes["height"]["estimate"] == pytest.approx(-TOO_LOW_M, abs=0.01)
    assert causes["height"]["low"] < -TOO_LOW_M < causes["height"]["high"]
    text = " ".join(command("compare", base, folder).stdout.split())
    assert text.startswith("worse: ")
    assert re.search(r"world 1[23] cm too low 95 %: .{,20} mount height", text)
    (back,) = json.loads(command("compare", folder, base, "--json", code=0).stdout)
    assert back["decision"] == "better"
    since = json.loads(
        command("diagnose", folder, "--since", base, "--workers", 1, "--json", code=0).stdout
    )
    assert since["changes"] == comparison["causes"]
    assert {cause["name"] for cause in since["causes"]} == {*named}
    absolute = {cause["name"]: cause["estimate"] for cause in since["causes"]}
    assert absolute == {name: cause.estimate for name, cause in named.items()}, (
        "against the real scans, not the base"
    )
    text = " ".join(
        command("diagnose", folder, "--since", base, "--workers", 1, code=0).stdout.split()
    )
    assert text.index("Fix first 1 ") < text.index(f"Changed since {base}")


def test_a_blind_sector_is_worse_and_explains_its_missing_parts(base, tmp_path):
    write_streets(tmp_path / "streets", blind)
    command(
        "run",
        tmp_path / "streets",
        "--out",
        tmp_path / "run",
        "--preset",
        "reference",
        "--workers",
        1,
        code=0,
    )
    assert [cause.name for cause in open_run(tmp_path / "run").record.overview.causes] == [
        "blind sector"
    ]
    (comparison,) = json.loads(
        command("compare", base, tmp_path / "run", "--json", code=0).stdout
    )
    assert comparison["decision"] == "worse"
    assert [cause["name"] for cause in comparison["causes"]] == ["blind sector"]


def test_a_gate_tests_the_size_of_a_cause(folder, named, tmp_path):
    limits = [
        f"--max=causes.{name}=0.03"
        for name in ("height", "roll", "intensity_scale", "height.high")
    ]
    done = command("gate", folder, *limits, "--out", tmp_path, code=4)
    judged = {
        row["measure"]: row
        for row in json.loads((tmp_path / "gate.json").read_text())["criteria"]
    }
    assert judged["causes.height"]["value"] == abs(named["height"].estimate)
    assert judged["causes.height.high"]["value"] == -named["height"].low
    assert judged["causes.roll"]["passed"]
    assert judged["causes.intensity_scale"]["value"] is None
    assert "constant" in done.stdout
    wrong = command("gate", folder, "--max", "causes.heights=1")
    assert "did you mean causes.height?" in wrong.stderr


def test_a_healthy_re_measurement_has_no_cause_and_what_is_unknown_is_shown_with_its_reason(
    tmp_path,
):
    settings = load(None, [], preset="reference")
    rng = np.random.default_rng(2)
    frames = []
    for seed in range(N_PAIRS):
        scan = make_pair(seed, 0, SENSORS["hdl64"], 20_000).real.rows[:, :3]
        frames.append(evaluate_pair(scan, healthy(scan, rng), settings).causes)
    pairs = []
    for frame in frames:
        pairs.append(frame.astype(object).where(frame.notna(), None).to_dict("records"))
    values = cause_values(pairs)
    assert named_causes(values, np.arange(N_PAIRS)) == []
    unknown = {name: group.reason for group in unknown_causes(values) for name in group.causes}
    assert "intensity scale" in unknown
    assert all(unknown.values())


def values_of(**amounts):
    """Amounts of some causes in as many pairs as the longest has; 0 of all others."""
    n_pairs = max(len(np.atleast_1d(values)) for values in amounts.values())
    pairs = []
    for i in range(n_pairs):
        pair = {name: {"amount": 0.0, "share": 0.0} for name in CAUSES}
        for name, values in amounts.items():
            amount = float(np.broadcast_to(values, n_pairs)[i])
            pair[name.replace("_", " ")] = {"amount": amount, "share": 0.5}
        pairs.append([{"cause": name} | row for name, row in pair.items()])
    return cause_values(pairs), np.arange(n_pairs)


def test_no_pairs_have_no_causes():
    assert cause_values([]) == {}


def names_of(**amounts):
    return sorted(cause.name for cause in named_causes(*values_of(**amounts)))


def test_a_displacement_that_explains_little_is_small_and_not_named():
    values, blocks = values_of(height=[0.08] * 3, lost_returns=[0.2] * 3)
    values["height"] = values["height"].assign(share=0.05)
    named, small = named_and_small(values, blocks)
    assert [cause.name for cause in named] == ["lost returns"]
    assert small == ["world 8 cm too high"]


@pytest.mark.parametrize(
    ("n_pairs", "heading"), [(1, "within 1 pair: "), (2, "within 2 pairs: "), (3, "95 %: ")]
)
def test_an_interval_without_differences_between_pairs_is_headed_so(n_pairs, heading):
    (cause,) = named_causes(*values_of(height=[0.2] * n_pairs))
    assert amount_words(cause).startswith(heading)


def test_nothing_is_said_to_be_without_a_cause_where_many_are_unknown():
    few = Unknown(causes=("beams",), reason="why")
    many = Unknown(causes=tuple(CAUSES)[:20], reason="two sweeps")
    assert no_cause_words([few]).endswith("two measurements of one scene; 1 of 38 are unknown")
    assert (
        no_cause_words([few, many])
        == "no cause can be named: 21 of 38 are unknown (two sweeps)"
    )


def test_no_more_causes_are_unknown_than_there_are():
    nothing = [{"cause": name, "reason": "two sweeps"} for name in CAUSES]
    unknown = unknown_causes(cause_values([nothing]))
    assert no_cause_words(unknown) == "no cause can be named: 38 of 38 are unknown (two sweeps)"


def test_pairs_that_disagree_name_nothing():
    assert names_of(sideways=[0.5, -0.2, 0.6, 0.1]) == []
    assert names_of(sideways=[0.5, 0.4, 0.6, 0.5]) == ["sideways"]


def test_neighbouring_pairs_count_once():
    values, _ = values_of(sideways=[0.5, 0.5, 0.5, 0.5, -0.4, -0.4])
    assert named_causes(values, np.array([0, 0, 0, 0, 1, 2])) == []


def test_causes_that_feign_each_other_are_named_once():
    assert names_of(elevation_noise=[0.05] * 3, azimuth_noise=[0.05] * 3) == [
        "azimuth noise",
        "elevation noise",
    ]
    assert names_of(elevation_noise=[0.05] * 3, pitch=[1.0] * 3) == ["pitch"]
    assert names_of(elevation_noise=[0.15] * 3, pitch=[1.0] * 3) == ["elevation noise", "pitch"]
    assert names_of(range_scale=[-0.02] * 3) == ["range scale"]
    assert names_of(range_scale=[-0.02] * 3, range_bias=[0.15] * 3) == [], "a bent world"
    assert names_of(beams=[9.0] * 3) == ["beams"]
    assert names_of(beams=[9.0] * 3, road_height=[0.05] * 3) == ["road height"]
    assert names_of(flat_shapes=[0.12] * 3, solid_foliage=[0.6] * 3) == ["solid foliage"]
    assert names_of(flat_shapes=[0.2] * 3, solid_foliage=[0.3] * 3) == ["flat shapes"]
    assert names_of(**{FLAT.replace(" ", "_"): [0.8] * 3}) == [], "more than shapes is wrong"
    bent = {"missing_parts": [0.01] * 3, "invented_parts": [0.01] * 3}
    assert names_of(moved_parts=[0.05] * 3) == ["moved parts"]
    assert names_of(moved_parts=[0.05] * 3, **bent) == ["invented parts", "missing parts"]
    assert names_of(lost_returns=[0.1] * 3, **{UNEVEN.replace(" ", "_"): [0.1] * 3}) == []


def test_changes_are_named_beyond_the_resolution_and_losses_are_relative():
    before, blocks = values_of(
        lost_returns=[0.4] * 4, intensity_scale=[0.5] * 4, roll=[0.0] * 4
    )
    after, _ = values_of(lost_returns=[0.55] * 4, intensity_scale=[0.25] * 4, roll=[0.15] * 4)
    changes = {cause.name: cause for cause in changed_causes(before, after, {}, blocks)}
    assert sorted(changes) == ["intensity scale", "lost returns", "roll"]
    assert changes["lost returns"].estimate == pytest.approx(0.25)
    assert changes["intensity scale"].words == "intensities 50 % too high"
    between = {"roll": np.zeros(4)}
    assert "roll" not in {
        cause.name for cause in changed_causes(before, after, between, blocks)
    }


@pytest.mark.parametrize("n_pairs", [80, 100, 400])
def test_what_was_measured_between_forty_pairs_of_many_is_named(n_pairs):
    values, blocks = values_of(roll=[0.0] * n_pairs)
    between = {"roll": np.full(n_pairs, np.nan)}
    between["roll"][:40] = 0.5
    (roll,) = changed_causes(values, values, between, blocks)
    assert (roll.name, roll.estimate) == ("roll", pytest.approx(0.5))
    between["roll"][:] = np.nan
    assert changed_causes(values, values, between, blocks) == []


def test_an_interval_covers_places_accuracy_and_proportional_errors():
    model = CAUSES["mixed pixels"]
    for amount in (0.006, 0.06, 0.6):
        mean, low, high = cause_interval(model, np.full(4, amount), np.arange(4))
        assert (mean - low, high - mean) == pytest.approx(
            [np.hypot(0.7 * model.resolution, model.relative * amount)] * 2
        )


def test_every_cause_has_words_and_a_tolerance():
    assert list(CAUSES)[: len(PARAMETERS)] == [*PARAMETERS]
    for model in CAUSES.values():
        assert 0 < model.resolution <= model.tolerance
        assert model.kind in ("sensor", "world")
        assert all("{size}" in words for words in model.words)
