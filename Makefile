# make run    sets up, makes a small synthetic dataset, evaluates it, makes its report, says where all is
# make test   sets up, runs every check and test but the exhaustive ones (make check is the same)
# make test-all  the same with the exhaustive tests: every setting, column, fault and cluster, hours of them
# make test-slice  15 minutes of the exhaustive tests, others each day; those that were not reached are listed
# make docs   builds the documentation: build/docs/index.html
# make faults kills, fills, damages and misleads real runs in every way known
# make bench  runs the benchmarks of speed, memory and power (an hour or so; DATA names the folder of the real scans)
# Each target sets up what it needs in .venv; PYTHON=python3.12 chooses the interpreter.

PYTHON ?= python3
DATA ?= ../shared/data
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find pipeline stages schemas -type f -not -path '*/__pycache__/*' | sort)
FILE_LIST := $(shell echo '$(SOURCES)' | cksum | cut -d' ' -f1)
LOCK := requirements.lock
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# As many processes as cores; a file of tests stays in one of them, until another one has nothing left to do.
# So tests of clusters run one after the other without an xdist group, for which loadgroup would build in each process
# what the tests of a file share.
AT_ONCE := --numprocesses auto --dist worksteal
TESTED := -m "not exhaustive"
SPHINX := $(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --fresh-env docs build/docs

.PHONY: run test test-all test-slice check lint faults docs bench clean setup browser javascript lock release-check test-pythons

run: setup
	$(BIN)/fidpipe synth .cache/streets --pairs 8
	$(BIN)/fidpipe run .cache/streets --preset reference --out runs/streets
	$(BIN)/fidpipe report runs/streets

test: check

test-all: TESTED :=
test-all: check

# The documentation is built on one core while the code is checked on another.
check: setup browser javascript
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target lint docs
	$(BIN)/pytest $(AT_ONCE) $(TESTED)

lint: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy -p fidpipe
	$(BIN)/lint-imports
	$(BIN)/codespell
	$(BIN)/python tools/plain.py

test-slice: setup
	$(BIN)/pytest $(AT_ONCE) --slice $$(($$(date +%s) / 86400)) --minutes 15

# Every fault, some hundred tries, an hour or so.
faults: setup
	$(BIN)/pytest -s tests/faults

docs: setup
	$(SPHINX)

bench: setup
	$(BIN)/python benchmarks/floor.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/floor.py $(DATA)/kitti_twin --every 3
	$(BIN)/python benchmarks/throughput.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/steps.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/speedup.py $(DATA)/kitti_twin
	$(BIN)/python benchmarks/growth.py
	$(BIN)/fidpipe twin $(DATA)/kitti_sequence .cache/twins --pairs '*[02468]'
	$(BIN)/python benchmarks/power.py $(DATA)/kitti_twin .cache/twins --out .cache/power
	$(BIN)/python benchmarks/decisions.py $(DATA)/kitti_twin .cache/twins --out .cache/decisions
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
# All that is fetched is in the lock with its hash, setuptools too, which builds the package.
$(VENV)/installed-$(FILE_LIST): pyproject.toml $(LOCK)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes --requirement $(LOCK)
	$(PIP) --no-deps --no-build-isolation --config-settings editable_mode=strict --editable .
	rm -f $(VENV)/installed-*
	touch $@

# After a change of dependencies; versions that still fit stay. UPGRADE=--upgrade takes the newest of all.
# requirements-run.lock is the part of it that a run needs: for images and clusters.
LOCKED = $(BIN)/uv pip compile pyproject.toml --universal --generate-hashes --no-annotate --quiet \
	--custom-compile-command "make lock"

lock: setup
	$(LOCKED) --extra all --extra dev --extra docs $(UPGRADE) --output-file $(LOCK)
	$(LOCKED) --extra all --constraint $(LOCK) --upgrade --output-file requirements-run.lock

# Under each Python with the locked versions, and with the lowest versions that pyproject.toml allows. TESTS= runs the
# exhaustive ones too; interpreters of pyenv are found with PYENV_VERSION=3.11.7:3.12.1:3.13.0 or the like.
PYTHONS ?= 3.11 3.12 3.13
TESTS ?= $(TESTED)

test-pythons: setup
	for version in $(PYTHONS) lowest; do \
		place=.cache/python-$$version; \
		if [ $$version = lowest ]; then \
			$(BIN)/uv venv --quiet --clear --python $(firstword $(PYTHONS)) $$place && \
			$(BIN)/uv pip install --quiet --compile-bytecode --python $$place --resolution lowest-direct '.[all,dev]'; \
		else \
			$(BIN)/uv venv --quiet --clear --python $$version $$place && \
			$(BIN)/uv pip install --quiet --compile-bytecode --python $$place --require-hashes --requirement $(LOCK) && \
			$(BIN)/uv pip install --quiet --python $$place --no-deps --no-build-isolation .; \
		fi && $$place/bin/pytest $(AT_ONCE) $(TESTS) || exit 1; \
	done

# Archives, clean installs, extras, licences, the Dockerfile's steps: some minutes, wants the package index.
release-check: setup
	$(BIN)/python tools/release.py

clean:
	rm -rf $(VENV) build .cache *.egg-info
