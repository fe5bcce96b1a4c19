"""The record of a run as typed values: what is written is read back, and keeps the layout of its JSON."""

import json

import pytest

from fidpipe.schemas.record import RunRecord


@pytest.fixture(scope="module")
def record(finished):
    """Content of `run.json` of a small run."""
    return json.loads((finished / "run.json").read_text())


def test_a_record_that_is_read_and_written_again_is_the_same_to_the_byte(record):
    assert json.dumps(RunRecord.model_validate(record).as_dict()) == json.dumps(record)


def test_a_record_without_findings_keeps_a_null(record):
    read = RunRecord.model_validate(record | {"findings": None})
    assert read.as_dict()["findings"] is None


def test_what_a_later_version_adds_is_passed_on(record):
    assert RunRecord.model_validate(record | {"weather": {"rain": 0.5}}).as_dict()[
        "weather"
    ] == {"rain": 0.5}


@pytest.mark.parametrize("key", ["summary", "findings", "inputs", "libraries"])
def test_a_record_of_another_layout_is_refused(record, key):
    with pytest.raises(ValueError, match=key):
        RunRecord.model_validate({name: value for name, value in record.items() if name != key})
