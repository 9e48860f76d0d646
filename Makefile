# `make run` or `make test` is all that a fresh machine with Python and make needs: the environment comes by itself.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
SOURCES := $(shell find invdyn_cli conf experiments -type f -not -name '*.pyc') pyproject.toml README.md LICENSE

# The longest first, so that two at a time end together.
PUBLISHED = adaptation batch_simulated dbm seven_joints filters

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv run test lint format tables figures real real-diagnosis confusion unknown multiple taken-up gear-play replay detection excite hyperparameters latency worn defects transfer bench fuzz wheel clean $(PUBLISHED:%=table-%)

# What stands on make's command line goes to the experiment as it is: make confusion seed=3 logs=2
OPTIONS = seed logs clean only effects noises workers folder data docs cases duration most epochs repetitions seconds pairs permutations
said = $(strip $(foreach name,$(OPTIONS),$(if $(filter command,$(firstword $(origin $(name)))),$(name)=$($(name)))))
ONE_THREAD = OMP_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false# each, where two processes share two cores
EXPERIMENT = PYTHONPATH=. $(BIN)/python experiments

help:  ## what there is to make
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: $(INSTALLED)  ## the environment: .venv with the package (editable) and what developing it takes

run: $(INSTALLED)  ## one experiment: nets on noisy simulated data, into outputs/runs
	$(BIN)/invdyn run model=ffnn data=sim_noisy

test: lint  ## everything that must hold: lint, then all tests
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(INSTALLED)  ## ruff and pyright
	$(BIN)/ruff check --quiet
	$(BIN)/ruff format --check --quiet
	$(BIN)/pyright

format: $(INSTALLED)  ## put imports and lines in order
	$(BIN)/ruff check --quiet --fix
	$(BIN)/ruff format

tables: $(INSTALLED)  ## the paper's shape on simulated data, into outputs/tables; two experiments at a time
	$(MAKE) --jobs=2 --output-sync=target $(PUBLISHED:%=table-%)

$(PUBLISHED:%=table-%): table-%: $(INSTALLED)
	$(ONE_THREAD) $(BIN)/invdyn tables experiment=$*

figures: $(INSTALLED)  ## the paper's figures, real robots too where their logs are, and outputs/paper/index.html beside the paper
	$(BIN)/invdyn figures

real: $(INSTALLED)  ## the same models on real robots' logs
	$(BIN)/invdyn tables experiment=real_logs
	$(BIN)/invdyn tables experiment=ur10e_load

real-diagnosis: $(INSTALLED)  ## what the simulations of real robots get wrong, into outputs/real_diagnosis (only=, docs=true)
	$(EXPERIMENT)/real_diagnosis.py $(said)

worn: $(INSTALLED)  ## worn arms with one anomaly or none, on plants that differ (seed=, logs=, clean=, only=)
	$(EXPERIMENT)/worn.py $(said)

defects: $(INSTALLED)  ## defects put into sound logs, and what invdyn check says (seed=, logs=, clean=, only=, data=, pairs=, permutations=)
	$(EXPERIMENT)/defects.py $(said)

transfer: $(INSTALLED)  ## learned on one recording of a real robot, judged on another, beside plain baselines (only=, docs=true)
	$(EXPERIMENT)/transfer.py $(said)

confusion: $(INSTALLED)  ## what is hidden and what is named: the confusion matrix (seed=, logs=, clean=, only=)
	$(EXPERIMENT)/confusion.py $(said)

unknown: $(INSTALLED)  ## causes that the catalogue lacks: what is said of them (seed=, logs=, only=)
	$(EXPERIMENT)/unknown.py $(said)

multiple: $(INSTALLED)  ## several causes at once: F1 (seed=, logs=, only=)
	$(EXPERIMENT)/multiple.py $(said)

taken-up: $(INSTALLED)  ## a load taken up and put down, with friction in every joint (seed=, logs=)
	$(EXPERIMENT)/taken_up.py $(said)

gear-play: $(INSTALLED)  ## what gear play looks like on three arms (seed=, docs=true)
	$(EXPERIMENT)/gear_play.py $(said)

replay: $(INSTALLED)  ## two causes, diagnosed, written as MJCF, replayed in MuJoCo: by how much the error falls (seed=, logs=)
	$(EXPERIMENT)/replay.py $(said)

detection: $(INSTALLED)  ## the smallest sizes that are found, over noise, into docs/ (seed=, logs=, effects=)
	$(EXPERIMENT)/detection.py docs=true $(said)

excite: $(INSTALLED)  ## ambiguous logs, the trajectory that each asks for, and what it settles (seed=, cases=, only=)
	$(EXPERIMENT)/excite.py $(said)

hyperparameters: $(INSTALLED)  ## how nets go on learning: adapting against forgetting (seed=, epochs=, repetitions=)
	$(EXPERIMENT)/hyperparameters.py $(said)

latency: $(INSTALLED)  ## what a tick of a 1 kHz loop costs (seconds=, docs=true)
	$(EXPERIMENT)/latency.py $(said)

bench: $(INSTALLED)  ## times against PyTorch (pip install torch; left out with a word without it) and Pinocchio
	$(BIN)/python experiments/bench.py

fuzz: $(INSTALLED)  ## damaged logs, URDFs, runs and options, drawn anew (examples=)
	$(ONE_THREAD) INVDYN_FUZZ_EXAMPLES=$(or $(examples),2000) $(BIN)/python -m pytest -q -n 2 tests/fuzz

wheel: dist/.built  ## the wheel, into dist

clean:  ## remove what building and testing left; outputs and .venv stay
	rm -rf dist build .cache .pytest_cache .ruff_cache .import_linter_cache *.egg-info
	find invdyn_cli tests experiments -name __pycache__ -prune -exec rm -rf {} +

$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is too old; allowed: 3.11 and later. Try: make PYTHON=python3.12"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/python -m pip install --quiet --editable . --group dev
	@touch $@

dist/.built: $(INSTALLED) $(SOURCES)
	$(BIN)/python -m build --wheel --no-isolation
	@touch $@
