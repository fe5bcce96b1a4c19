"""What the engine announces before it works."""

from fidpipe.pipeline.engine.costs import CostModel
from fidpipe.pipeline.engine.engine import large_pairs_text


def test_a_pair_of_many_points_is_announced_with_its_memory_and_minutes():
    text = large_pairs_text([400_000, 2_000_000], CostModel())
    assert "1 of 2 pairs have 500,000 points or more; the largest has about 2,000,000; with all" in text
    assert "some 11 GiB of memory and 17 minutes, more where points are dense; thin both sides" in text
    assert not large_pairs_text([400_000], CostModel())
