"""The examples in the docstrings, run."""

import doctest
import importlib
import pkgutil

import pytest

import fidpipe

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(fidpipe.__path__, "fidpipe.")
    if not module.name.endswith("worker_start")
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_are_true(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_there_are_examples():
    finder = doctest.DocTestFinder()
    assert (
        sum(
            bool(test.examples)
            for name in MODULES
            for test in finder.find(importlib.import_module(name))
        )
        >= 8
    )
