# `make run` or `make test` is all that a fresh machine with Python and make needs: the environment comes by itself.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
DOCS := .docs-venv
SOURCES := $(shell find invdyn_cli hydra_plugins conf experiments -type f -not -name '*.pyc') pyproject.toml README.md LICENSE

PUBLISHED = adaptation batch_simulated dbm seven_joints filters

# Every experiment is a target, with _ or -: make taken-up seed=3. What stands on make's command line goes to it as it is.
EXPERIMENTS := $(basename $(notdir $(wildcard experiments/*.yaml)))
ALIASES := $(sort $(EXPERIMENTS) $(subst _,-,$(EXPERIMENTS)))
said = $(filter-out PYTHON=% VENV=% BIN=% INSTALLED=% NAME=%,$(MAKEOVERRIDES))
ONE_THREAD = OMP_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false# each, where two processes share two cores

# Tests compile some thousand programs that run once: without these passes that takes a third of the time. A version of
# XLA that lacks one of the options would end at it, so they are tried first.
QUICK = --xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true \
  --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1
TESTED = OMP_NUM_THREADS=1 XLA_FLAGS="$$(XLA_FLAGS="$(QUICK)" $(BIN)/python -c 'import jax; jax.devices()' 2>/dev/null \
  && echo $(QUICK) || echo --xla_cpu_multi_thread_eigen=false)"

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv run test lint tables figures grand real experiment fuzz docs wheel $(ALIASES)

help:  ## what there is to make
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: $(INSTALLED)  ## the environment: .venv with the package (editable) and what developing it takes

run: $(INSTALLED)  ## one experiment: nets on noisy simulated data, into outputs/runs
	$(BIN)/invdyn run model=ffnn data=sim_noisy

test: $(INSTALLED)  ## all tests, one of them is lint; marked=benchmark: the same claims on more effects, seeds and sizes
	$(if $(marked),$(ONE_THREAD),$(TESTED)) $(BIN)/python -m pytest -n 2 --dist worksteal $(if $(marked),-m $(marked))

lint: $(INSTALLED)  ## ruff and pyright; fix=true puts imports and lines in order first
	$(if $(fix),$(BIN)/ruff check --quiet --fix; $(BIN)/ruff format)
	$(BIN)/ruff check --quiet
	$(BIN)/ruff format --check --quiet
	$(BIN)/pyright

tables: $(INSTALLED)  ## the paper's shape on simulated data, into outputs/tables; two runs at a time
	for name in $(PUBLISHED); do $(ONE_THREAD) $(BIN)/invdyn experiment $$name workers=2 || exit; done

figures: $(INSTALLED)  ## the paper's figures, real robots too where their logs are, and outputs/paper/index.html beside the paper
	$(ONE_THREAD) $(BIN)/invdyn figures workers=2

real: real_logs ur10e_load  ## the same models on real robots' logs

experiment: $(INSTALLED)  ## NAME=confusion seed=3 logs=2, or make confusion seed=3 logs=2; without NAME: list them
	$(BIN)/invdyn experiment $(NAME) $(said)

$(ALIASES): $(INSTALLED)
	$(BIN)/invdyn experiment $@ $(said)

grand: $(INSTALLED)
	$(ONE_THREAD) $(BIN)/invdyn experiment grand_comparison workers=2 $(said)

fuzz: $(INSTALLED)  ## damaged logs, URDFs, runs and options, drawn anew (examples=)
	$(ONE_THREAD) INVDYN_FUZZ_EXAMPLES=$(or $(examples),2000) $(BIN)/python -m pytest -q -n 2 tests/fuzz

docs: $(DOCS)/.installed  ## the pages as a site, into site (mkdocs-material, in an environment of its own)
	rm -rf build/pages && mkdir -p build/pages/experiments
	cp -R docs README.md ARCHITECTURE.md CHANGELOG.md CONTRIBUTING.md SECURITY.md LICENSE build/pages
	cp experiments/*.md experiments/*.yaml build/pages/experiments
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --strict --quiet

wheel: dist/.built  ## the wheel, into dist

$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is too old; allowed: 3.11 and later. Try: make PYTHON=python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable . --group dev
	@touch $@

$(DOCS)/.installed: pyproject.toml
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -m pip install --quiet --upgrade "pip>=25.1"
	$(DOCS)/bin/python -m pip install --quiet --group docs
	@touch $@

dist/.built: $(INSTALLED) $(SOURCES)
	$(BIN)/python -m build --wheel --no-isolation
	@touch $@
