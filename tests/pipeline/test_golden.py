import json

import pytest

import golden
from runs import STAGE_NAMES


@pytest.fixture(scope="module")
def measured():
    return golden.measure()


@pytest.fixture(scope="module")
def wanted():
    return json.loads(golden.FILE.read_text())


@pytest.mark.parametrize("stage", STAGE_NAMES)
def test_the_numbers_of_a_stage_change_only_with_its_code_version(measured, wanted, stage):
    found = measured[stage]
    kept = wanted[stage]
    assert not golden.differs(found["numbers"], kept["numbers"]), (
        f"numbers of stage {stage} changed under version {found['version']} (golden: {kept['version']}); if that is "
        "meant, raise the version in pipeline/jobs, say why in CHANGELOG.md, and run python tools/golden.py"
    )
    assert found["version"] == kept["version"], (
        "the version was raised: run python tools/golden.py"
    )


def test_the_comparison_sees_a_small_change():
    assert golden.differs([[1.0, 2.0]], [[1.0, 2.0 + 1e-5]])
    assert golden.differs([[1.0]], [[1.0], [2.0]])
    assert not golden.differs([[1.0, 2.0]], [[1.0, 2.0 + 1e-12]])
