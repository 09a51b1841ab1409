# `make demo` and `make test` need nothing but Python 3.11 to 3.13: each builds its own .venv.

# The first that runs: a version manager's shim may be on the path without its Python.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c "" 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-demo
PACKAGES := kinfeas plugins scenes sim2real configs
FRESH = build/$(notdir $(PYTHON))
MERGED := build/merged
WORKERS ?= auto

.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow test-python docs reference lint types layers merged format clean

help:  ## Show the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 18

install: $(STAMP)  ## Build .venv with the tested versions

demo: $(or $(wildcard $(STAMP)),$(DEMO_STAMP))  ## Train a PR2 base policy, evaluate it and write a report
	$(BIN)/kinfeas demo

test: $(STAMP) lint  ## Check style, types and layers, then run the fast tests
	$(BIN)/python -m pytest -n auto -m "not slow"

# Those over ROS, in real time, are in one file: two of them at once are too much for two cores.
test-slow: $(STAMP)  ## Run the tests that take longer
	$(BIN)/python -m pytest -n auto --dist loadfile -m slow

# In a copy of the tree, so that the wheel has no file of an earlier build; the tests import the
# wheel, not the copy's packages, to which the pages link.
test-python:  ## Run the fast tests with the wheel in a fresh environment of PYTHON=python3.12
	rm -rf $(FRESH) && mkdir -p $(FRESH)/source && $(PYTHON) -m venv $(FRESH)/venv
	git ls-files -z -co --exclude-standard | xargs -0 cp --parents -t $(FRESH)/source
	$(FRESH)/venv/bin/pip wheel -q --no-deps -w $(FRESH) $(FRESH)/source
	$(FRESH)/venv/bin/pip install -q "$$(echo $(FRESH)/*.whl)[test]"
	cd $(FRESH)/source && rm -r $(PACKAGES) && \
		../venv/bin/python -m pytest -n $(WORKERS) -m "not slow" --ignore tests/test_wheel.py --ignore tests/test_docs.py

docs: $(STAMP)  ## Build the documentation site: build/site/index.html
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --jobs auto docs build/site

reference: $(STAMP)  ## Write the generated parts of docs/reference
	$(BIN)/python docs/reference_pages.py

lint: $(STAMP)  ## Check style, types and layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(MAKE) --no-print-directory types layers

# Types and layers are those of a copy in which every package lies below kinfeas, as installed. mypy
# ends with 2 if a machine is too busy to start its workers in time. Studies import each other.
MYPY = MYPYPATH=studies "$(CURDIR)/$(BIN)/mypy" --config-file "$(CURDIR)/pyproject.toml" \
	--cache-dir "$(CURDIR)/.mypy_cache" kinfeas docs studies

types: merged
	cd $(MERGED) && { $(MYPY) || { test $$? = 2 && $(MYPY) --num-workers 0; }; }

layers: merged
	cd $(MERGED) && "$(CURDIR)/$(BIN)/lint-imports" --config "$(CURDIR)/pyproject.toml" \
		--no-cache --no-logo

merged: $(STAMP)
	@rm -rf $(MERGED) && mkdir -p $(MERGED)/docs && cp -p docs/*.py $(MERGED)/docs && \
		cp -rp kinfeas studies $(MERGED) && cp -rp $(filter-out kinfeas,$(PACKAGES)) $(MERGED)/kinfeas

format: $(STAMP)  ## Format the code and mend what ruff can mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## Remove .venv and everything built
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps make a second call quick; a change of the dependencies or entry points installs anew.
$(STAMP): EXTRAS := test,dev
$(DEMO_STAMP): EXTRAS := train,plots
$(STAMP) $(DEMO_STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --no-compile -c constraints.txt -e ".[$(EXTRAS)]"
	$(COMPILE)
	touch $@

# Bytecode is compiled by all cores; some packages bring templates that are no Python. The demo
# imports a small part of its packages and compiles that by itself.
$(STAMP): COMPILE = @$(BIN)/python -m compileall -qq -j 0 $(VENV) || true
