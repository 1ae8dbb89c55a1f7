PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --constraint constraints.txt

.PHONY: demo test quick check format pages docs serve-docs clean

# Draw, film and measure the baselines; the last line shows how to watch them.
demo: .venv/demo
	$(BIN)/collaborative-gym demo

# Format, lint, types and tests. Two processes with two threads each would wait for one
# another on two cores. Tests start hundreds of processes, each of which would compile the
# package anew if Python were not to write what it has compiled.
test: check
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/pytest --numprocesses 2 \
	  --dist worksteal

# Format, lint, and the quick tests of the rooms that change most: 200 core-seconds.
QUICK := $(addprefix tests/,robots scene sim control comparisons policies tasks \
  evaluation test_api.py test_errors.py test_math.py test_imports.py test_plugins.py)
quick: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	OMP_NUM_THREADS=1 $(BIN)/pytest -m "not slow" $(QUICK) --numprocesses 2 \
	  --dist worksteal

check: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/pyright

format: .venv/dev
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

# What the documentation has of the code, written anew into its pages.
pages: .venv/docs
	$(BIN)/python docs/made_pages.py

# The documentation, into site/.
docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

serve-docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs serve

clean:
	rm -rf .venv out site

.venv/bin/pip:
	$(PYTHON) -m venv .venv

.venv/demo: pyproject.toml constraints.txt | .venv/bin/pip
	@echo "installing into .venv first, which takes a minute or two"
	$(PIP) --editable ".[video,view]"
	touch $@

.venv/docs: pyproject.toml constraints.txt | .venv/bin/pip
	$(PIP) --editable ".[docs]"
	touch $@

.venv/dev: pyproject.toml constraints.txt | .venv/bin/pip
	@echo "installing into .venv first, which takes a few minutes"
	$(PIP) --editable ".[dev]"
	touch $@ .venv/demo .venv/docs
