# `make run` and `make test` work on a fresh machine that has Python >= 3.11 and nothing else of ours.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test lint bench docs clean

run: .venv/ready
	$(BIN)/mast study case_study

test: .venv/ready
	$(BIN)/python -m pytest

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv/ready
	$(BIN)/python benchmarks/lockstep.py
	$(BIN)/python benchmarks/inproc.py
	$(BIN)/python benchmarks/secure.py
	$(BIN)/python benchmarks/link.py

docs: .venv/ready
	$(BIN)/python -m mast_zenoh.documentation docs

# Kernels are compiled when the package is installed: again when their sources have changed.
.venv/ready: pyproject.toml hatch_build.py $(wildcard mast_zenoh/kernels/*.pyx mast_zenoh/kernels/*.pxd)
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv runs .pytest_cache .mypy_cache .ruff_cache .hypothesis
