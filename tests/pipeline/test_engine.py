"""What the engine announces before it works."""

from fidpipe.pipeline.datasets.content import ScanContent
from fidpipe.pipeline.datasets.pairs import ScanPair
from fidpipe.pipeline.engine.engine import Machines, RunEngine, Survey
from fidpipe.pipeline.engine.pool import Pool
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.schemas.settings import Settings
from runs import listening


def test_a_pair_of_many_points_is_announced_with_its_memory_and_minutes(tmp_path):
    folder, (reporter, said) = RunFolder(tmp_path / "run"), listening()
    with folder.locked(), RunEngine(folder, Settings(), Machines(pool=Pool()), reporter) as engine:
        for n in (200_000, 1_000_000):
            engine.contents[str(n)] = dict.fromkeys(("real", "sim"), ScanContent("", "", n))
        survey = Survey(todo=[ScanPair(name, None, None) for name in engine.contents])
        with engine.making(survey, lambda pair: None, lambda: None):
            pass
    assert "1 of 2 pairs have 500,000 points or more; the largest has about 2,000,000; with all" in said.getvalue()
    assert "some 11 GiB of memory and 17 minutes, more where points are dense; thin both sides" in said.getvalue()
