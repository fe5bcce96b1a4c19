"""Statistics of the paper's experiments: the choice of parameters."""

import numpy as np

from fidpipe.stages.paper.parameter_choice import ParameterSet, Trial, choose_parameters

BASE = ParameterSet(90, 0.2, 5.0, 1.0)
VALUES = {"k": (30, 60, 90, 120, 150), "tau_m": (0.1, 0.2, 0.3, 0.5), "t": (0.1, 0.5, 1.0, 2.0, 5.0)}


def trials(rng, n_pairs, effect=0.0):
    """An experiment in which every value gives the same scores but for chance; `effect` is that of k = 60."""
    made = []
    for name, values in VALUES.items():
        tried = [BASE.with_value(name, value) for value in values]
        rates, r_lambdas = rng.normal(0, 1, (2, n_pairs, 1)) + rng.normal(0, 0.3, (2, n_pairs, len(tried)))
        if name == "k":
            rates[:, 1] += effect
        made.append(Trial(name, tried, tried.index(BASE), rates, r_lambdas))
    return made


def replaced(choices):
    return [choice.name for choice in choices if choice.chosen != BASE]


def test_without_any_effect_a_setting_is_replaced_in_at_most_one_of_twenty_experiments():
    rng = np.random.default_rng(0)
    n = 400
    for n_pairs in (5, 10, 50):
        rate = np.mean([bool(replaced(choose_parameters(trials(rng, n_pairs)))) for _ in range(n)])
        assert rate <= 0.05 + 2.33 * (0.05 * 0.95 / n) ** 0.5, n_pairs


def test_an_effect_of_two_standard_deviations_is_found_on_ten_pairs():
    rng = np.random.default_rng(0)
    found = [replaced(choose_parameters(trials(rng, 10, effect=0.9))) for _ in range(100)]
    assert sum("k" in names for names in found) > 80
