# make run    sets up, makes a small synthetic dataset, evaluates it, makes its report, says where all is
# make test   sets up, runs every check and test (make check is the same; make fast leaves out the slow tests)
# make bench  runs every benchmark (an hour or so; DATA names the folder of the real scans)
# make fuzz   gives every reader 100,000 hostile inputs (hours; INPUTS=1000 for fewer), then has atheris guide as many
# Each target sets up what it needs in .venv; PYTHON=python3.12 chooses the interpreter.

PYTHON ?= python3
DATA ?= ../shared/data
INPUTS ?= 100000
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find pipeline stages schemas -type f -not -path '*/__pycache__/*' | sort)
FILE_LIST := $(shell echo '$(SOURCES)' | cksum | cut -d' ' -f1)
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt \
	--config-settings editable_mode=strict

.PHONY: run test check fast bench fuzz clean setup browser javascript

run: setup
	$(BIN)/fidpipe synth .cache/streets --pairs 4
	$(BIN)/fidpipe run .cache/streets --out runs/streets
	$(BIN)/fidpipe report runs/streets

test: check

check: setup browser javascript
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy -p fidpipe
	$(BIN)/lint-imports
	$(BIN)/pytest

fast: setup
	$(BIN)/pytest -m "not slow"

fuzz: setup
	$(INSTALL) --editable '.[all,dev,fuzz]' || echo "no atheris for this Python: inputs are made, not guided"
	$(BIN)/python tests/hostile/campaign.py --inputs $(INPUTS)
	if $(BIN)/python -c 'import atheris'; then $(BIN)/python tests/hostile/guided.py --inputs $(INPUTS); fi

bench: setup
	$(BIN)/python benchmarks/floor.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/floor.py $(DATA)/kitti_twin --every 3
	$(BIN)/python benchmarks/throughput.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/steps.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/speedup.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/growth.py
	$(BIN)/fidpipe twin $(DATA)/kitti_sequence .cache/twins --pairs '*[02468]'
	$(BIN)/python benchmarks/power.py $(DATA)/kitti_twin .cache/twins --out .cache/power
	$(BIN)/python benchmarks/small_pairs.py 50
	$(BIN)/python benchmarks/small_pairs.py 10000 300

# The pages' JavaScript is formatted and linted by biome, as pinned in tests/javascript.
javascript:
	@if command -v npm > /dev/null; then \
		cd tests/javascript && npm install --no-save --silent && npm run --silent check; \
	else \
		echo "no npm: the JavaScript of the pages is not checked"; \
	fi

# The browser tests want Debian's Chromium; where it is absent and cannot be installed, they are skipped.
browser:
	@if ! command -v chromium || ! command -v chromedriver; then \
		if command -v apt-get && [ "$$(id -u)" = 0 ]; then \
			apt-get update && apt-get install --yes --no-install-recommends chromium chromium-driver; \
		else \
			echo "no chromium and chromedriver: the browser tests will be skipped"; \
		fi; \
	fi

setup: $(VENV)/installed-$(FILE_LIST)

# A strict editable install links file by file: a new file or new metadata means installing again.
$(VENV)/installed-$(FILE_LIST): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --editable '.[all,dev]'
	rm -f $(VENV)/installed-*
	touch $@

clean:
	rm -rf $(VENV) build .cache *.egg-info
