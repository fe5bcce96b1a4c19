# make run    sets up, makes a small synthetic dataset, evaluates it, says where the results are
# make test   sets up, runs every check and test (make check is the same; make fast leaves out the slow tests)
# Each target sets up what it needs in .venv; PYTHON=python3.12 chooses the interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find pipeline stages schemas -name '*.py' -not -path '*/__pycache__/*' | sort)
FILE_LIST := $(shell echo '$(SOURCES)' | cksum | cut -d' ' -f1)
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt \
	--config-settings editable_mode=strict

.PHONY: run test check fast clean setup

run: setup
	$(BIN)/fidpipe synth .cache/streets --pairs 4
	$(BIN)/fidpipe run .cache/streets --out runs/streets

test: check

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy -p fidpipe
	$(BIN)/lint-imports
	$(BIN)/pytest

fast: setup
	$(BIN)/pytest -m "not slow"

setup: $(VENV)/installed-$(FILE_LIST)

# A strict editable install links file by file: a new file or new metadata means installing again.
$(VENV)/installed-$(FILE_LIST): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --editable '.[synth,patchwork,icp,dev]'
	rm -f $(VENV)/installed-*
	touch $@

clean:
	rm -rf $(VENV) build .cache *.egg-info
