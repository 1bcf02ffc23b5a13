# `make demo` and `make test` need only Python and make; each makes its own virtual environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint study fuzz bench clean

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $(STAMP)

demo: $(STAMP)  ## calibrate a real measured room
	$(BIN)/rtcal calibrate rtcal/datasets/bras_cr2/room.toml rtcal/datasets/bras_cr2/measured.csv --out demo

test: $(STAMP)  ## the plain test suite
	$(BIN)/python -m pytest -m "not study"

lint: $(STAMP)  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

study: $(STAMP)  ## the long studies
	$(BIN)/python -m pytest -m study

fuzz: $(STAMP)  ## 10,000 broken files into every reader
	$(BIN)/python benchmarks/fuzz_files.py 10000

bench: $(STAMP)  ## speed, as ratios in one run
	$(BIN)/python benchmarks/resolve.py
	$(BIN)/python benchmarks/composed.py
	$(BIN)/python benchmarks/path_tracing.py
	$(BIN)/python benchmarks/shoebox_simulators.py
	$(BIN)/python benchmarks/exact_batch.py
	$(BIN)/python -m benchmarks.solvers run --short

clean:
	rm -rf $(VENV) demo build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
