"""Tables, settings, commands and exit codes are those of the list that `tools/contract.py` writes."""

import json

import pytest

import contract
from fidpipe.schemas.tables import TABLES
from toys import TOY_TABLES

STORED = json.loads(contract.FILE.read_text())


@pytest.fixture(scope="module")
def present():
    with pytest.MonkeyPatch.context() as patch:
        for toy in TOY_TABLES:
            patch.delitem(TABLES, toy.name)
        return json.loads(json.dumps(contract.measure()))


@pytest.mark.parametrize("subject", STORED)
def test_the_contract_is_the_stored_one(subject, present):
    assert present[subject] == STORED[subject]
    assert present.keys() == STORED.keys()
