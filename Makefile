# dlwpredict: everything a newcomer or a bench computer needs, as targets. `make help` lists them.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DLW := $(BIN)/dlwpredict
RUNS ?= runs
RECORDINGS ?= ../shared/recordings

# One matrix thread beside our own: more of them only get in each other's way.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help
help: ## List the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sort -u | awk -F ':.*## ' '{printf "  make %-18s %s\n", $$1, $$2}'

# -- environment ------------------------------------------------------------------------------
.PHONY: install
install: $(VENV)/.installed ## Make the virtual environment (other targets do it by themselves)

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: $(PYTHON) is older than Python 3.11; say make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --editable . --group dev
	touch $@

# -- jobs: demo, real prints, generations -----------------------------------------------------
include $(filter-out configs/workflow.mk,$(wildcard configs/*.mk))  # workflow.mk is for a lab's own folder

# -- the daily targets ------------------------------------------------------------------------
.PHONY: demo test test-long test-fast check format docs clean
demo: $(DEMO_RESULTS) ## The whole loop on sample_data/: align, calibrate, diagnose, correct, print again, a page
	@$(BIN)/python -m tests.bench.demo $(DEMO) $(SEVEN)

test: $(VENV)/.installed ## Run the tests, on all cores
	$(BIN)/python -m pytest -p tests.skipped -p tests.longest_first -n auto --dist loadfile -m "not long"

test-long: $(VENV)/.installed ## Run the others: five seconds and more each
	$(BIN)/python -m pytest -p tests.skipped -p tests.longest_first -n auto --dist loadfile -m long

test-fast: $(VENV)/.installed ## Run those tests that take no longer than about a second
	$(BIN)/python -m pytest -p tests.skipped -p tests.longest_first -n auto --dist loadfile -m "not slow"

.PHONY: fuzz test-crash
fuzz: $(VENV)/.installed ## Bad files against every reader (about an hour; FUZZ="--inputs 1000")
	$(BIN)/python -m tests.fuzz $(FUZZ)

test-crash: $(VENV)/.installed ## Kill every command while it writes (CRASH="--kills 20")
	$(BIN)/python -m tests.crash $(CRASH)

.PHONY: mutants
mutants: $(VENV)/.installed ## Write the numerics wrong, place by place: do the tests see it? (40 minutes; MUTANTS="--only mesh")
	$(BIN)/python -m tests.mutants $(MUTANTS)

check: $(VENV)/.installed ## Lint, check format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: $(VENV)/.installed ## Format the code
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

docs: $(VENV)/.installed ## Write the pages of commands, effects and evidence; a test fails while one is stale
	$(BIN)/python docs/make.py

.PHONY: site pictures
site: $(VENV)/.installed ## The documentation as a site, in runs/site
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --group site
	$(BIN)/python -m sphinx -W --keep-going -q -c docs . $(RUNS)/site
	echo '<meta http-equiv="refresh" content="0; url=docs/index.html">' > $(RUNS)/site/index.html

pictures: demo ## Draw the pictures of the documentation anew
	$(BIN)/python docs/picture.py $(DEMO)
	$(BIN)/python docs/signatures.py

clean: ## Remove the environment and all runs
	rm -rf $(VENV) $(RUNS) *.egg-info .pytest_cache .ruff_cache .hypothesis

# -- benchmarks -------------------------------------------------------------------------------
.PHONY: bench
bench: $(VENV)/.installed ## Speed, as ratios measured side by side (half an hour; BENCH="startup predict", BENCH="large")
	$(BIN)/python -m tests.bench.speed --folder $(RUNS)/bench $(BENCH)

.PHONY: bench-model bench-align bench-calibration bench-diagnose bench-agreement
bench-model: $(VENV)/.installed ## Fast against voxel: agreement, time, memory
	$(BIN)/python -m tests.bench.model

bench-align: $(VENV)/.installed ## Alignment errors over synthetic recordings
	$(BIN)/python -m tests.bench.align

bench-calibration: $(VENV)/.installed ## Coverage of the intervals; fast against simplex (about an hour)
	$(BIN)/python -m tests.bench.calibration

bench-diagnose: $(VENV)/.installed ## Diagnosis against concealed truth (hours; resumes; BENCH_DIAGNOSE="--nulls 60 --singles 2")
	$(BIN)/python -m tests.bench.diagnosis $(RUNS)/bench-diagnose $(BENCH_DIAGNOSE)

bench-agreement: $(VENV)/.installed ## Press against program, effect by effect, beside all that a fit may move (10 minutes)
	$(BIN)/python -m tests.bench.agreement $(AGREEMENT) --json $(RUNS)/bench/agreement.json
