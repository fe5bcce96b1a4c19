"""What the engine announces before it works."""

from fidpipe.pipeline.engine.costs import CostModel
from fidpipe.pipeline.engine.engine import large_pairs_text


def test_a_pair_of_many_points_is_announced_with_its_memory_and_minutes():
    text = large_pairs_text([400_000, 2_000_000], CostModel())
    assert all(words in text for words in ("1 of 2 pairs", "2,000,000", "11 GiB", "17 minutes"))
    assert not large_pairs_text([400_000], CostModel())
