"""How much the scores depend on the seed of the communities, and which differences are more than chance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from .layout import number, plain_table

_MOST_PAIRS = 20

#: Scores in the tables: column of `seeds`, and heading.
_SCORES = (
    ("match_rate", "match rate"),
    ("cdc_mean", "CDC"),
    ("r_lambda_mean", "r_lambda"),
    ("r_gap_mean", "r_gap"),
    ("centroid_distance_m_mean", "offset m"),
)
_OF_A_PAIR = _SCORES[:4]


def seeds_view(seeds: Mapping[str, Any]) -> RenderableType:
    """Spread over seeds beside spread over pairs, and mean and deviation over seeds of each pair."""
    n_seeds, n_pairs = seeds["n_seeds"], seeds["n_pairs"]
    columns = ("score", "mean", "std over\npairs", "std over\nseeds", "real above\n(a pair)", "real above\n(all pairs)")
    dataset = plain_table(f"How stable the scores are ({n_seeds} seeds, {n_pairs} pairs)", *columns)
    for name, heading in _SCORES:
        of = seeds["dataset"][name]
        values = (of["mean"], of["std_pairs"], of["std_seeds"], of["least_pair"], of["least_dataset"])
        dataset.add_row(heading, *map(number, values))
    pairs = seeds["pairs"]
    chosen, title = list(pairs), "Pairs (mean ± standard deviation over seeds)"
    if len(pairs) > _MOST_PAIRS:
        chosen = sorted(pairs, key=lambda pair_id: -(pairs[pair_id]["match_rate"]["std"] or 0.0))[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs whose match rate depends most on the seed (mean ± standard deviation)"
    table = plain_table(title, "pair", *(heading for _, heading in _OF_A_PAIR))
    table.columns[0].min_width = 6
    for pair_id in chosen:
        of_pair = (pairs[pair_id][name] for name, _ in _OF_A_PAIR)
        table.add_row(Text(pair_id), *(f"{number(of['mean'])} ± {number(of['std'])}" for of in of_pair))
    lines = (
        "real above: two results under seeds of their own, of one pair or the means of all pairs, that differ by less",
        "may differ by chance alone (95 %); a simulator is better than another only if it is so by more",
    )
    return Group(dataset, *map(Text, lines), table)
