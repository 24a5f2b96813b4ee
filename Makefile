# `make demo` and `make test` do everything on a fresh machine; see README.md.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input install -qq -c constraints.txt
READY := $(VENV)/.installed
READY_DEV := $(VENV)/.installed-dev
PYTEST_ARGS ?= -n auto --maxprocesses 8 --dist loadfile

.PHONY: demo test lint hard dist pins audit bench clean

demo: $(READY)  ## the whole pipeline on the bundled character; pictures in demo/
	$(BIN)/prtnet demo --out demo

test: lint  ## style, types, every test, and what is shipped
	$(BIN)/python -m pytest $(PYTEST_ARGS)
	$(MAKE) dist

lint: $(READY_DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

dist: $(READY_DEV)  ## wheel and sdist in dist/, tried in an empty environment
	$(BIN)/python -m scripts.distributions

pins: $(READY_DEV)  ## constraints.txt and docs/licences.md, of what is installed
	$(BIN)/python -m scripts.pins
	$(BIN)/python -m scripts.licences

audit: $(READY_DEV)  ## known vulnerabilities of what is pinned; says so where nobody can be asked
	@$(BIN)/python -m scripts.audit || [ $$? = 3 ]

hard: $(READY_DEV)  ## the numerical torture tests; what each measured goes into docs/hard-cases.md
	$(BIN)/python -m pytest $(PYTEST_ARGS) tests/hard_cases --hypothesis-profile=ci --hard-table docs/hard-cases.md

bench: $(READY_DEV)  ## every number of docs/benchmarks.md and docs/papers.md
	@set -e; for script in $(filter-out bench/tables.py bench/charts.py,$(sort $(wildcard bench/[a-z]*.py))); do \
		echo "== $$script"; $(BIN)/python "$$script"; done

clean:
	rm -rf $(VENV) build dist demo .mypy_cache .pytest_cache .ruff_cache

$(READY): pyproject.toml constraints.txt scripts/make-venv.sh scripts/system-gl.sh
	@PYTHON="$(PYTHON)" bash scripts/make-venv.sh $(VENV)
	@bash scripts/system-gl.sh
	@echo "Installing prtnet into $(VENV) (some minutes the first time) ..."
	@$(PIP) -e .
	@touch $@

$(READY_DEV): $(READY)
	@echo "Installing what the tests need ..."
	@$(PIP) -e '.[dev,viewer]'
	@touch $@
