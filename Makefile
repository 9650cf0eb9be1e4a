# `make run` and `make test` work on a fresh machine that has only make and Python >= 3.11.
PYTHON ?= python3
BIN := .venv/bin
TOOLS := .venv/tools/bin
SITE := .venv/site
PIP := pip install --quiet --disable-pip-version-check

.PHONY: run kernels dev test test-all fuzz insiders lint lint-js lint-project bench bench-quick docs site pictures results lock dist wheels clean plugin-missing

# Installs only what running needs; the other targets add the tools for tests and development.
# `make run ARGS=--record` also writes every message.
run: .venv/installed
	$(BIN)/mast study case_study $(ARGS)

# Compiles the kernels again, for example after a C compiler has been installed.
kernels: .venv/installed
	$(INSTALL)

# All optional packages and the tools for tests and development.
dev: .venv/ready

# Three workers, also on two cores, because tests that start processes mostly wait; the heavy ones wait more. Tests of one
# file share fixtures that are slow to build, so they stay in one worker. They start thousands of processes, so bytecode is kept in any environment:
# without it, the tests take a third longer.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder
# All tests but those marked `heavy`; of TESTS, if given, all.
test: .venv/ready
	$(PYTEST) $(or $(TESTS),-m 'not heavy')

# These, then the heavy ones: containers, hosts, browsers, the commands of pages, every way to end a run.
test-all: test .venv/ros2/ready .venv/sumo .venv/site/ready
	$(PYTEST) -n 4 -m heavy --timeout 600

# Random draws, many more than `make test-all` makes; `make fuzz SEED=7` repeats those of an earlier run with that seed.
DRAWN := tests/runtime/test_malformed_input.py tests/mesh/test_malformed_control.py tests/simulation tests/testing \
	tests/runtime/test_any_order.py tests/faults tests/scenes/test_driven_traffic.py tests/evaluation/test_shipped_scenarios.py \
	tests/launch/test_exit_paths.py tests/v2x/test_malformed_messages.py \
	plugins/datasets/tests/test_all_readers.py plugins/ros2/tests/test_ros2_hostile.py
fuzz: SEED ?= $(shell $(PYTHON) -c 'import random; print(random.randrange(1 << 24))')
fuzz: .venv/ready
	$(PYTEST) --fuzz --fuzz-seed $(SEED) --timeout 3600 $(DRAWN)

# Attacks by one compromised node of each role: 200 messages of each kind on every control key. Takes about
# a quarter of an hour.
insiders: .venv/ready
	MAST_FORGERIES=200 $(BIN)/python -m pytest tests/deploy/test_insiders.py tests/mesh/test_secure_insider.py --timeout=600

lint: .venv/ready lint-project
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(if $(shell command -v npm),$(MAKE) lint-js)

# Files that only GitHub, PyPI and the builders of wheels read: against their schemas, and for workflows that a stranger could
# misuse. Nothing is asked on the network.
SCHEMA := $(TOOLS)/check-jsonschema --quiet --builtin-schema
lint-project: .venv/tools/ready
	$(SCHEMA) vendor.github-workflows .github/workflows/*.yml
	$(SCHEMA) vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(SCHEMA) vendor.github-issue-forms $(filter-out %/config.yml,$(wildcard .github/ISSUE_TEMPLATE/*.yml))
	$(SCHEMA) vendor.dependabot .github/dependabot.yml
	$(SCHEMA) vendor.citation-file-format CITATION.cff
	$(TOOLS)/zizmor --offline --quiet .github
	$(TOOLS)/validate-pyproject pyproject.toml plugins/*/pyproject.toml
	$(TOOLS)/cibuildwheel --platform linux --archs x86_64,aarch64 --print-build-identifiers

# The page's JavaScript: lint, types by JSDoc, unit tests. Node and npm are for development only.
lint-js: node_modules/ready
	npm run --silent lint
	npm run --silent types
	npm run --silent test

node_modules/ready: package.json package-lock.json
	npm ci --no-audit --no-fund --silent
	touch $@

# Speed in ratios, to the last release and to peers: in ten minutes, or roughly in one.
bench: .venv/ready
	$(BIN)/python benchmarks/ratios.py --minutes 10

bench-quick: .venv/ready
	$(BIN)/python benchmarks/ratios.py --minutes 1

docs: .venv/ready
	$(BIN)/python tools/generate_docs.py docs

# The pages and the public names as a site that needs no server: build/site/index.html.
site: .venv/ready .venv/site/ready
	PYTHONPATH=$(SITE) $(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going docs $(or $(OUT),build/site)

# All pictures of docs/ and README.md, or some: `make pictures PICTURES=interception.gif`.
pictures: .venv/ready
	$(BIN)/python tools/pictures.py $(PICTURES)

# The pages of docs/results/ and the figures of them, for hours, on all cores or on a Dask cluster; repeat it to go on after an interruption.
# With QUICK=1 all of them in ten minutes, into build/results. `make results PAGES=attacks CLUSTER=tcp://HOST:8786`.
results: .venv/ready
	$(BIN)/python tools/results.py $(if $(QUICK),--quick) $(if $(CLUSTER),--cluster $(CLUSTER)) $(PAGES)

# Run this after changing dependencies in pyproject.toml. `make lock UPGRADE=--upgrade` updates all packages.
# The lock file for running is a subset of the one for development, with the same versions and hashes.
LOCK := $(TOOLS)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --custom-compile-command 'make lock'
lock: .venv/tools/ready
	$(LOCK) $(UPGRADE) --extra dev --output-file requirements-dev.txt pyproject.toml
	$(LOCK) --constraint requirements-dev.txt --group build --output-file requirements.txt pyproject.toml
	$(LOCK) $(UPGRADE) --group tools --output-file requirements-tools.txt
	$(LOCK) $(UPGRADE) --group pyproject.toml:ros2 --output-file requirements-ros2.txt
	$(LOCK) --constraint requirements-dev.txt --group site --output-file requirements-site.txt
	$(LOCK) --constraint requirements-dev.txt --extra sumo --output-file requirements-sumo.txt pyproject.toml

# Release files: source archives and wheels of the package and its plugins, and the bill of materials (CycloneDX) of the wheel with its dependencies.
dist: .venv/ready .venv/tools/ready
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/python -m build --no-isolation --outdir dist plugins/datasets
	$(BIN)/python -m build --no-isolation --outdir dist plugins/ros2
	$(TOOLS)/uv venv --quiet --python $(BIN)/python dist/installed
	$(TOOLS)/uv pip install --quiet --python dist/installed --constraint requirements-dev.txt dist/*.whl
	$(TOOLS)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --output-file dist/mast-zenoh.cdx.json dist/installed
	rm -rf dist/installed

# Wheels for all Linux machines with this processor, one for each Python: needs a container engine.
wheels: .venv/tools/ready
	$(TOOLS)/cibuildwheel --platform linux --output-dir dist/wheels

# Kernels are compiled when the package is installed, and again when their sources change. pip hides how that ended, so
# the last command tells. Other packages come from the lock file; with --no-build-isolation, the build uses them too.
INSTALL = $(BIN)/$(PIP) --no-deps --no-build-isolation --editable . --editable plugins/datasets --editable plugins/ros2 && $(BIN)/python -m mast_zenoh.kernels
# They run again if one of the plugins has been uninstalled.
.venv/installed: $(foreach plugin,datasets ros2,$(if $(wildcard .venv/lib/python*/site-packages/mast_zenoh_$(plugin)-*),,plugin-missing)) pyproject.toml $(wildcard plugins/*/pyproject.toml) requirements.txt hatch_build.py $(wildcard mast_zenoh/kernels/*.pyx mast_zenoh/kernels/*.pxd) mast_zenoh/kernels/table_columns.py
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "expected Python 3.11 or newer, found " + sys.version'
	$(PYTHON) -m venv .venv
	$(BIN)/$(PIP) --require-hashes --requirement requirements.txt
	$(INSTALL)
	touch $@

.venv/ready: requirements-dev.txt | .venv/installed
	$(BIN)/$(PIP) --require-hashes --requirement requirements-dev.txt
	touch $@

.venv/tools/ready: requirements-tools.txt
	$(PYTHON) -m venv .venv/tools
	$(TOOLS)/$(PIP) --require-hashes --requirement requirements-tools.txt
	touch $@

# ROS 2 itself, for the tests that compare with it: they are skipped, with the reason, where there are no wheels of it.
.venv/ros2/ready: requirements-ros2.txt | .venv/installed
	$(PYTHON) -m venv .venv/ros2
	-.venv/ros2/bin/$(PIP) --require-hashes --requirement requirements-ros2.txt
	touch $@

# Sphinx and its theme, beside the packages whose docstrings it shows.
.venv/site/ready: requirements-site.txt | .venv/ready
	rm -rf .venv/site
	$(BIN)/$(PIP) --require-hashes --target .venv/site --requirement requirements-site.txt
	touch $@

# SUMO, for the tests that simulate with it: they are skipped, with the reason, where there is no wheel of it.
.venv/sumo: requirements-sumo.txt | .venv/ready
	-$(BIN)/$(PIP) --require-hashes --requirement requirements-sumo.txt
	touch $@

clean:
	rm -rf .venv runs build docs/modules .pytest_cache .mypy_cache .ruff_cache .hypothesis
