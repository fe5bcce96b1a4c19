"""How much the scores depend on the seed of the communities, and which differences are more than chance."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.text import Text

from ....schemas.metrics import HEADLINE_SCORES, labels, metric_of
from ....schemas.results import SeedSummary
from .layout import number, plain_table

_MOST_PAIRS = 20

#: The scores that are shown of each pair; all headline scores would not fit.
_PAIR_SCORES = HEADLINE_SCORES[:4]


def seeds_view(seeds: SeedSummary) -> RenderableType:
    """Spread over seeds beside spread over pairs, and mean and deviation over seeds of each pair."""
    columns = (
        *("score", "mean", "std over\npairs", "std over\nseeds"),
        *("real above\n(one pair)", "real above\n(all pairs)"),
    )
    dataset = plain_table(f"How stable the scores are ({seeds.n_seeds} seeds, {seeds.n_pairs} pairs)", *columns)
    for name in HEADLINE_SCORES:
        spread = seeds.dataset[name]
        values = (spread.mean, spread.std_pairs, spread.std_seeds, spread.least_pair, spread.least_dataset)
        dataset.add_row(metric_of(name).label, *map(number, values))
    pairs = seeds.pairs
    chosen, title = list(pairs), "Pairs (mean ± standard deviation over seeds)"
    if len(pairs) > _MOST_PAIRS:
        chosen = sorted(pairs, key=lambda pair_id: -(pairs[pair_id]["match_rate"].std or 0.0))[:_MOST_PAIRS]
        title = f"The {_MOST_PAIRS} pairs whose match rate depends most on the seed (mean ± standard deviation)"
    table = plain_table(title, "pair", *labels(_PAIR_SCORES))
    table.columns[0].min_width = 6
    for pair_id in chosen:
        scores = (pairs[pair_id][name] for name in _PAIR_SCORES)
        table.add_row(Text(pair_id), *(f"{number(score.mean)} ± {number(score.std)}" for score in scores))
    lines = (
        "real above: two results under seeds of their own, of one pair or the means of all pairs, that differ by less",
        "may differ by chance alone (95 %); a simulator is better than another only if it is so by more",
    )
    return Group(dataset, *map(Text, lines), table)
