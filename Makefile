# `make demo` and `make test` need only Python and make. The demo has a virtual environment of its
# own, with nothing but the report; all other targets share one with the developers' tools.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SEMINAR := rtcal/datasets/seminar_room
DEMO_VENV := .venv-demo
DEMO_STAMP := $(DEMO_VENV)/.installed

.PHONY: demo test test-all lint docs notebooks study fuzz mutate bench clean

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $(STAMP)

$(DEMO_STAMP): pyproject.toml
	$(PYTHON) -m venv $(DEMO_VENV)
	$(DEMO_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[report]'
	touch $(DEMO_STAMP)

demo: $(DEMO_STAMP)  ## calibrate a real measured room; diagnose a second one, in which something is hidden
	$(DEMO_VENV)/bin/rtcal calibrate rtcal/datasets/bras_cr2/room.toml \
		rtcal/datasets/bras_cr2/measured.csv --out demo
	$(DEMO_VENV)/bin/rtcal report demo
	@printf "\nA second room, simulated by code that is not rtcal's. What does its model lack?\n\n"
	$(DEMO_VENV)/bin/rtcal diagnose $(SEMINAR)/room.toml $(SEMINAR)/pairs.csv --paths 3000 --out demo/diagnosis
	@$(DEMO_VENV)/bin/python -c 'import json, sys; \
		print("\nHidden in it:", json.load(open(sys.argv[1]))["hidden"])' $(SEMINAR)/truth.json

# Two processes. Each takes a half of the tests in their order, so that a module's fixtures are made
# once, and what is left of the other's half when it is done. Bytecode is kept, for the commands that
# tests run. Linear algebra takes one thread in each: two would wait for the other process' two.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

test: $(STAMP)  ## the tests, within three minutes on two cores
	$(PYTEST) -m "not study and not long"

test-all: $(STAMP)  ## every test but the studies: notebooks, browser, long blocks of the docs too
	$(PYTEST) -m "not study"

lint: $(STAMP)  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(STAMP)  ## the documentation site, warnings as errors, in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

notebooks: $(STAMP)  ## run every notebook in full and store its outputs; fails where one prints other than was stored
	$(BIN)/python -m benchmarks.notebooks

study: $(STAMP)  ## the long studies
	$(BIN)/python -m pytest -m study

FUZZ_SECONDS ?= 3600
fuzz: $(STAMP)  ## libFuzzer on every reader for FUZZ_SECONDS each (an hour)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check atheris
	$(BIN)/python benchmarks/fuzz_readers.py $(FUZZ_SECONDS)

mutate: $(STAMP)  ## 300 deliberate faults: which does no test see?
	$(BIN)/python benchmarks/mutation.py

bench: $(STAMP)  ## speed, as ratios in one run
	$(BIN)/python benchmarks/resolve.py
	$(BIN)/python benchmarks/speed.py --times 1
	$(BIN)/python benchmarks/path_tracing.py
	$(BIN)/python benchmarks/shoebox_simulators.py
	$(BIN)/python -m benchmarks.solvers run --short

clean:
	rm -rf $(VENV) $(DEMO_VENV) mutants site demo build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
