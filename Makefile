# Needs Python 3.11 or newer and make; everything else is set up in .venv, from pinned versions.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup test check speed learns docs entries test-all test-others test-newest dist dist-check \
	tag workflows quickstart clean

VENV := .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
READY := $(VENV)/.ready
EXTRAS := dev,docs,human,report,video,minari,hub
COMPANIONS := "baselines[tensorboard]" "goals[learners]" play
# The first interpreter that runs; `make PYTHON=/path/to/python` overrules it.
PYTHON ?= $(firstword $(foreach name,python3.11 python3.12 python3.13 python3,\
	$(shell $(name) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $(name))))
# Without bytecode every process that a test starts would compile the package again.
unexport PYTHONDONTWRITEBYTECODE
# In the files' order: those with the fewest tests, which would come last, take longest.
PYTEST_FLAGS ?= -q -rs -n auto --dist loadfile --no-loadscope-reorder

help: ## this list
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

setup: $(READY) ## the virtual environment in .venv, pinned versions, editable

$(READY): pyproject.toml baselines/pyproject.toml goals/pyproject.toml play/pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "error: no Python 3.11 or newer found; set PYTHON=" >&2; exit 1; }
	@echo "setting up $(VENV) with $(PYTHON): minutes, and gigabytes with a CUDA build of PyTorch"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python tools/install.py $(EXTRAS) $(COMPANIONS) stable-baselines3
	@touch $@

test: $(READY) ## all tests on one Python
	@$(BIN)/python -m pytest $(PYTEST_FLAGS)

check: $(READY) ## lint, format, budgets of lines, layers, types, documentation
	@failed=; \
	$(BIN)/ruff check --quiet . || failed+=" lint"; \
	$(BIN)/ruff format --check --quiet --diff . || failed+=" format"; \
	$(BIN)/python tools/budgets.py || failed+=" budgets"; \
	$(BIN)/lint-imports --no-logo --no-cache || failed+=" layers"; \
	$(BIN)/mypy || failed+=" types"; \
	$(BIN)/python -m tools.site || failed+=" docs"; \
	test -z "$$failed" || { echo "failed:$$failed" >&2; exit 1; }

docs: $(READY) ## the documentation site, in site/
	@$(BIN)/python -m tools.site

speed: $(READY) ## speeds as ratios to a fixed workload
	@$(BIN)/python benchmarks/regression.py

learns: $(READY) ## whether behavioural cloning learns, in two minutes
	@$(BIN)/python benchmarks/learns.py

entries: $(READY) ## check the entries submitted to the leaderboard, running a sample again
	@$(BIN)/python -m tools.entries

# All of pyenv's interpreters count, where there are any.
PYENV := PYENV_VERSION="$$(ls $${PYENV_ROOT:-$$HOME/.pyenv}/versions 2>/dev/null | paste -sd:)"

test-all: $(READY) ## the tests on each supported Python of this machine, without PyTorch
	@$(PYENV) $(BIN)/nox

test-others: $(READY) ## those that take seconds, on the Pythons that `make test` has not used
	@$(PYENV) $(BIN)/nox -s light

test-newest: $(READY) ## the tests with the newest version of every dependency
	@$(BIN)/nox -s newest

dist: $(READY) ## wheel and source distribution in dist/, built in a clean environment
	@$(BIN)/nox -s dist

dist-check: $(READY) ## what a new user does with the wheel alone; the source distribution's tests
	@$(BIN)/nox -s wheel sdist

tag: $(READY) ## whether TAG, version and changelog agree
	@$(BIN)/python tools/check_tag.py "$(TAG)"

workflows: $(READY) ## lint the workflows and the Dockerfile
	@$(BIN)/nox -s workflows

quickstart: $(READY) ## the package's main job, from nothing to a result
	@$(BIN)/magical quickstart

clean: ## remove the virtual environments, caches and build products
	rm -rf .venv .nox build dist site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find src tests baselines goals play benchmarks studies examples tools integrations -name __pycache__ -type d -prune -exec rm -rf {} +
