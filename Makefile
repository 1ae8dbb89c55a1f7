PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --constraint constraints.txt

.PHONY: demo test check format clean

# Evaluate the expert on all eight environments: a table, videos and a contact sheet.
demo: .venv/demo
	$(BIN)/collaborative-gym demo

# Format, lint, types and tests.
test: check
	$(BIN)/pytest --numprocesses 2

check: .venv/dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/pyright

format: .venv/dev
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

clean:
	rm -rf .venv out

.venv/bin/pip:
	$(PYTHON) -m venv .venv

.venv/demo: pyproject.toml constraints.txt | .venv/bin/pip
	$(PIP) --editable ".[video]"
	touch $@

.venv/dev: pyproject.toml constraints.txt | .venv/bin/pip
	$(PIP) --editable ".[dev]"
	touch $@ .venv/demo
