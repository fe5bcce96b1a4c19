"""Causes from rows of `pairs` written by hand: what is named, in which order, and what is not."""

import numpy as np
import pandas as pd
import pytest

from fidpipe import evaluate_pair
from fidpipe.pipeline.results.causes import CAUSE_KINDS, Columns, find_causes, surface_causes, with_tolerance
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import TABLES
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.statistics.findings import BAND_EDGES_M

#: A healthy pair: the second measurement has a little more noise and loss.
HEALTHY = {
    "ground_real_peak_m": -1.77,
    "ground_sim_peak_m": -1.77,
    "shift_x_m": 0.004,
    "shift_y_m": -0.003,
    "shift_z_m": 0.001,
    "sensor_real_beams": 32,
    "sensor_sim_beams": 32,
    "sensor_real_range_noise_m": 0.009,
    "sensor_sim_range_noise_m": 0.0175,
    "sensor_real_lost_share": 0.05,
    "sensor_sim_lost_share": 0.08,
    "sensor_real_azimuth_step_deg": 0.199,
    "sensor_sim_azimuth_step_deg": 0.201,
    "sensor_real_range_quantum_m": 0.004,
    "sensor_sim_range_quantum_m": None,
    "missing_pieces_share": 0.0005,
    "invented_pieces_share": 0.0,
    "n_missing_pieces": 0,
    "n_invented_pieces": 0,
}


def rows_of(n=5, **changes):
    """Pairs with small differences between them; a change is added to the healthy value."""
    wobble = np.linspace(-0.003, 0.003, n)
    return [
        {"pair_id": str(i)}
        | {
            name: value if value is None or isinstance(value, int) else value * (1 + wobble[i])
            for name, value in HEALTHY.items()
        }
        | {name: (HEALTHY[name] or 0) + change * (1 + wobble[i]) for name, change in changes.items()}
        for i in range(n)
    ]


def of_real_side(names, n_points, alone):
    """Points of four pairs by group, and those of them without a counterpart."""
    return tuple(pd.DataFrame(np.broadcast_to(own, (4, len(names))), columns=names) for own in (n_points, alone))


NO_CLASSES = of_real_side([""], 1.0, 1.0)


def names(causes):
    return [cause.name for cause in causes]


def test_a_healthy_re_measurement_has_no_cause():
    assert HEALTHY.keys() <= set(TABLES["pairs"].schema.names)
    assert find_causes(Columns(rows_of())) == []


def test_a_low_and_noisy_simulator_is_named_with_direction_interval_and_setting():
    rows = rows_of(ground_sim_peak_m=-0.12, shift_z_m=-0.12, sensor_sim_range_noise_m=0.041 - 0.0175)
    low, noise = find_causes(Columns(rows))
    assert low.words == "simulated world 12 cm too low"
    assert low.detail == "shift z -0.12 ± 0.00 m, road -1.89 against -1.77 m"
    assert low.setting == "mount height, T_real_sim"
    assert low.low < low.estimate < low.high < 0
    assert low.estimate == pytest.approx(-0.12, abs=1e-3)
    assert (noise.words, noise.setting) == ("range noise 41 mm, real 9 mm", "noise_stddev")
    assert low.severity > noise.severity


def test_a_road_that_moves_alone_is_not_called_the_world():
    (road,) = find_causes(Columns(rows_of(ground_sim_peak_m=0.1)))
    assert road.words == "simulated road 10 cm too high"
    assert road.setting == "road height of the map"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"shift_x_m": 0.2}, "simulated world 20 cm too far ahead"),
        ({"shift_y_m": -0.2}, "simulated world 20 cm too far right"),
        ({"sensor_sim_lost_share": 0.22}, "30 % of the pulses lost, real 5 %"),
        ({"sensor_sim_beams": 32}, "64 beams, real 32"),
        ({"sensor_sim_azimuth_step_deg": 0.199}, "azimuth step 0.4 deg, real 0.199 deg"),
        ({"sensor_sim_range_quantum_m": 0.1}, "range steps 10 cm, real 4 mm"),
        ({"missing_pieces_share": 0.03, "n_missing_pieces": 8}, "8.0 missing pieces per pair, 3 % of the points"),
        (
            {"sensor_real_range_noise_m": 0.021, "sensor_sim_range_noise_m": -0.0175},
            "range noise 0 mm, real 30 mm",
        ),
        ({"invented_pieces_share": 0.05, "n_invented_pieces": 4}, "4.0 invented pieces per pair, 5 % of the points"),
    ],
)
def test_each_flaw_is_named(changes, words):
    assert [cause.words for cause in find_causes(Columns(rows_of(**changes)))] == [words]


def test_pairs_that_disagree_name_nothing_and_two_pairs_have_no_interval():
    rows = rows_of(4)
    for row, shift in zip(rows, (0.5, -0.2, 0.6, 0.1), strict=True):
        row["shift_x_m"] = shift
    assert find_causes(Columns(rows)) == []
    (two,) = find_causes(Columns(rows_of(2, shift_x_m=0.2)))
    assert (two.low, two.high, two.n_pairs) == (None, None, 2)
    split = rows_of(2)
    split[1]["shift_x_m"] = 0.9
    assert find_causes(Columns(split)) == []


def test_a_floor_is_subtracted():
    rows = rows_of(sensor_sim_lost_share=0.07)
    floor = {row["pair_id"]: row for row in rows_of(sensor_sim_lost_share=0.06)}
    assert names(find_causes(Columns(rows))) == ["lost pulses"]
    assert find_causes(Columns(rows), Columns(floor[row["pair_id"]] for row in rows)) == []


def test_unknown_values_name_nothing():
    rows = [{"pair_id": "a"} | dict.fromkeys(HEALTHY)] * 3
    assert find_causes(Columns(rows)) == []
    assert all(np.isnan(kind.value(Columns(rows))).all() for kind in CAUSE_KINDS.values())


def test_far_surface_is_named_at_the_distance_where_it_stands_out():
    bands, missing = range(len(BAND_EDGES_M)), np.array([100.0, 120.0, 100.0, 140.0, 780.0])
    (far,) = surface_causes(of_real_side(bands, 1000.0, missing), NO_CLASSES)
    assert far.words == "beyond 50 m 78 % of the surface missing"
    assert far.setting == "range, dropoff"
    assert far.severity == pytest.approx((0.78 - 0.115) / 5)
    assert surface_causes(of_real_side(bands, 1000.0, 400.0), NO_CLASSES) == []


def test_a_class_is_named_where_much_more_of_it_is_missing():
    classes = of_real_side(["car", "pole", "tree"], 500.0, [50.0, 450.0, 100.0])
    (pole,) = surface_causes(of_real_side(range(5), 500.0, 100.0), classes)
    assert pole.words == "pole: 90 % of the surface missing"


def test_differences_of_sensors_that_fix_first_does_not_name_are_marked():
    row = HEALTHY | {"sensor_sim_azimuth_step_deg": 0.4, "sensor_sim_beams": None}
    texts = ["range noise on smooth surfaces: 9 mm real, 18 mm simulated", "beams: 32 real, none detected simulated"]
    texts += ["azimuth step: 0.199 degrees real, 0.400 simulated", "beams start 0.11 m above the origin"]
    small, *others = with_tolerance(texts, row)
    assert small == f"{texts[0]} (too little for Fix first)"
    assert others == texts[1:]


def re_measured(scan, rng, noise_m, lost_share, shift_z_m=0.0):
    """The same scan with noise along the ray and lost points, moved in z."""
    kept = scan[rng.random(len(scan)) >= lost_share]
    range_m = np.linalg.norm(kept, axis=1, keepdims=True)
    return kept * (1 + rng.normal(0, noise_m, (len(kept), 1)) / range_m) + [0, 0, shift_z_m]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"noise_m": 0.02, "lost_share": 0.03}, []),
        ({"noise_m": 0.08, "lost_share": 0.03, "shift_z_m": -0.12}, ["height", "range noise"]),
    ],
)
def test_scans_that_were_moved_and_made_noisy_name_both_and_healthy_ones_nothing(change, expected):
    settings, rng, rows = load(None, [], preset="reference"), np.random.default_rng(1), []
    for seed in range(3):
        scan = make_pair(seed, 0, SENSORS["vlp16"], 12_000).real.rows[:, :3]
        rows.append(evaluate_pair(scan, re_measured(scan, rng, **change), settings).summary | {"pair_id": str(seed)})
    causes = find_causes(Columns(rows))
    assert sorted(names(causes)) == expected
    if causes:
        height, noise = sorted(causes, key=lambda cause: cause.name)
        assert height.estimate == pytest.approx(-0.12, abs=0.02)
        assert (height.words, height.setting) == ("simulated world 12 cm too low", "mount height, T_real_sim")
        assert noise.sim == pytest.approx(np.hypot(0.03, 0.08), rel=0.15)
