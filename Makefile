# sgms-mhe: `make help` lists what can be made.

PYTHON ?= python3
CC     ?= cc
JOBS   ?= 2
MACHINE ?= etel_xy
BUILD  ?= build

BIN := .venv/bin
RUN := $(BIN)/sgms-mhe
STAMP := .venv/.installed
# The machines whose packages stand in generated/; CONTRIBUTING.md has the reason of each.
COMMITTED := etel_xy etel_xy_controller etel_xy_switching
PACKAGES := $(if $(filter $(MACHINE),$(COMMITTED)),generated,$(BUILD)/generated)
WRITTEN_C = $(sort $(shell find runtime_c bench/c bench/yardstick tests/c -name '*.[ch]' -o -name '*.[ch]pp'))
# Packages hold these headers; what is emitted has lines of at most 100 columns.
EMITTED_H = $(sort $(wildcard runtime_c/sgms_*.h))
EMITTED_STYLE = '{BasedOnStyle: InheritParentConfig, ColumnLimit: 100, BinPackParameters: true}'

# Strict enough for a firmware project's own rules.
CFLAGS ?= -O2
C_WARNINGS := -std=c99 -pedantic -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow -Wmissing-prototypes -Werror

.DELETE_ON_ERROR:
.DEFAULT_GOAL := all
.PHONY: all help venv generate check-generated compile experiment figures docs notebooks picture test test-slow check lint lint-ruff lint-format \
        lint-types lint-c format studies faults lasting benchmark benchmark-diagnosis benchmark-logs benchmark-measured \
        target yardstick verify release-check wheel lock clean distclean

# Said before anything is done, of a call that names no target.
ifeq ($(filter-out all,$(MAKECMDGOALS)),)
$(info make: what it will do, and the computing time of each step, up to twice that on a busy host; `make help` lists what else there is)
$(info $()  environment  $(if $(wildcard $(STAMP)),is there,75 s   )  .venv with the versions of requirements.lock)
$(info $()  package      2 s       machines/$(MACHINE).toml -> $(PACKAGES)/$(MACHINE))
$(info $()  compile      2 s       $(BUILD)/$(MACHINE), every warning an error)
$(info $()  experiment   75 s      the paper's, 20 s in closed loop; its table, and figures in $(BUILD)/experiment)
endif

all: experiment ## (default) set up, generate etel_xy, compile it, run the paper's experiment, print its table

help: ## this list
	@awk 'BEGIN { FS = ":.*## " } /^[a-z-]+:.*## / { printf "  %-20s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo
	@echo "  PYTHON=$(PYTHON) CC=$(CC) JOBS=$(JOBS) MACHINE=$(MACHINE) BUILD=$(BUILD) may be overridden;"
	@echo "  PYTEST_ARGS goes to pytest."

# --- environment -----------------------------------------------------------------------------------------------------

venv: $(STAMP) ## .venv with exactly the versions of requirements.lock, this package and its workbench editable

# Only the lock decides: no dependency is resolved, and the build backend comes from the lock too.
$(STAMP): requirements.lock pyproject.toml bench/pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "make: $(PYTHON) not found; name a Python 3.11 or later: make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "make: $(PYTHON) is $$($(PYTHON) --version 2>&1), 3.11 or later is needed: make PYTHON=python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' || { \
	    echo "make: $(PYTHON) cannot make virtual environments; on Debian install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e . -e bench
	$(BIN)/python -m pip check
	@touch $@

lock: ## resolve the newest allowed versions and rewrite requirements.lock
	rm -rf $(BUILD)/lock && $(PYTHON) -m venv $(BUILD)/lock
	$(BUILD)/lock/bin/python -m pip install --quiet --upgrade setuptools hatchling
	$(BUILD)/lock/bin/python -m pip install --quiet --no-build-isolation -e '.[dev]' -e bench
	{ sed -n '/^#/p' requirements.lock; \
	  $(BUILD)/lock/bin/python -m pip freeze --all --exclude pip --exclude-editable; } > $(BUILD)/requirements.lock
	mv $(BUILD)/requirements.lock requirements.lock
	rm -rf $(BUILD)/lock

# --- generated packages ----------------------------------------------------------------------------------------------

generate: $(STAMP) ## regenerate every committed package, machines/NAME.toml -> generated/NAME
	@for name in $(COMMITTED); do \
	    echo "generate $$name" && $(RUN) generate machines/$$name.toml --out generated/$$name || exit; done

check-generated: $(STAMP) ## regenerate into a scratch folder; fail on any difference from generated/, or orphan in it
	@rm -rf $(BUILD)/check-generated && mkdir -p $(BUILD)/check-generated
	@for name in $(COMMITTED); do \
	    $(RUN) generate machines/$$name.toml --out $(BUILD)/check-generated/$$name >/dev/null || exit; done
	@diff -rq generated $(BUILD)/check-generated || { \
	    diff -ruN generated $(BUILD)/check-generated | head -n 80; \
	    echo "make: generated/ is not what machines/ gives; run 'make generate', delete orphans, and commit" >&2; exit 1; }
	@echo "generated/ is up to date: $(words $(COMMITTED)) machines"

compile: $(STAMP) ## generate MACHINE and compile it as C99 with every warning an error
	$(RUN) generate machines/$(MACHINE).toml --out $(PACKAGES)/$(MACHINE)
	@mkdir -p $(BUILD)/$(MACHINE)
	@rm -f $(BUILD)/$(MACHINE)/*.o $(BUILD)/$(MACHINE)/lib$(MACHINE).a
	@for source in $(PACKAGES)/$(MACHINE)/*.c; do \
	    object=$(BUILD)/$(MACHINE)/$$(basename $$source .c).o; \
	    echo "$(CC) $(CFLAGS) -c $$source" && \
	    $(CC) $(C_WARNINGS) $(CFLAGS) -I$(PACKAGES)/$(MACHINE) -c $$source -o $$object || exit; done
	ar rcs $(BUILD)/$(MACHINE)/lib$(MACHINE).a $(BUILD)/$(MACHINE)/*.o

# --- results ---------------------------------------------------------------------------------------------------------

experiment: compile ## the paper's experiment on MACHINE: table on stdout, figures and data in build/experiment
	$(RUN) experiment machines/$(MACHINE).toml --out $(BUILD)/experiment

figures: experiment ## run the experiment and put its figures into docs/figures
	@mkdir -p docs/figures
	find $(BUILD)/experiment -maxdepth 1 \( -name '*.svg' -o -name '*.png' \) -exec cp {} docs/figures/ \;

studies: $(STAMP) ## statistics: coverage, Monte Carlo against EKF and smoother, creep over 1e5 updates; half an hour
	@mkdir -p $(BUILD)/studies
	@for name in coverage monte-carlo plant creep; do \
	    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sgms_bench.studies $$name > $(BUILD)/studies/$$name.txt && \
	    cat $(BUILD)/studies/$$name.txt || exit; done

faults: $(STAMP) ## broken sensors in good logs: what each does to the estimate, worst of twenty; a few minutes
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sgms_bench.studies faults
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sgms_bench.studies lost

lasting: $(STAMP) ## errors of the model that stay: how often the truth is beyond the stated deviations; half an hour, SEEDS=1: two minutes
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sgms_bench.studies lasting $(if $(SEEDS),--runs $(SEEDS))

benchmark: $(STAMP) ## time, instructions and errors of MACHINE's variants beside CasADi's export; figures in build/benchmark
	$(RUN) bench machines/$(MACHINE).toml --out $(BUILD)/benchmark

target: $(STAMP) ## MACHINE on an emulated Cortex-M7: instructions, flash, RAM; needs arm-none-eabi-gcc and qemu-system-arm
	$(RUN) target machines/$(MACHINE).toml

yardstick: $(STAMP) ## one estimation problem on emulated Cortex-M4F and M7: this package, a filter by hand, CasADi's export
	$(BIN)/python -m sgms_bench.target.yardstick

verify: $(STAMP) ## random calls, bits, coverage, limits, constructs of emitted C, mutated logs: one table; CALLS=1e8 FUZZED=100 takes hours
	$(BIN)/python -m sgms_bench.verification --keep $(BUILD)/verify $(if $(CALLS),--calls $(CALLS)) \
	    $(if $(FUZZED),--machines $(FUZZED)) $(if $(LOGS),--logs $(LOGS)) $(if $(ONLY),--only $(ONLY))

benchmark-diagnosis: $(STAMP) ## plant every effect in simulated logs; how many are found, missed, invented
	$(RUN) bench-diagnosis machines/$(MACHINE).toml --out $(BUILD)/benchmark-diagnosis

benchmark-logs: $(STAMP) ## drawn logs in every format with every fault: read right, refused rightly, or wrong; minutes
	$(BIN)/python -m sgms_bench.logs $(if $(DRAWS),--draws $(DRAWS))

benchmark-measured: $(STAMP) ## measured records in DATA, by the table TABLE (DATA/measured.toml, or public ones): ours beside published numbers; minutes each
	$(BIN)/python -m sgms_bench.measured $(DATA) $(if $(TABLE),--table $(TABLE)) $(if $(ONLY),--only "$(ONLY)") $(if $(HALVES),--halves)

# --- documents -------------------------------------------------------------------------------------------------------

# Notebooks that run from a checkout alone.
$(BUILD)/notebooks/%.ipynb: examples/notebooks/%.py $(STAMP)
	$(BIN)/python docs/site/percent.py --run $< $@

docs: $(STAMP) $(BUILD)/notebooks/own_axis.ipynb $(BUILD)/notebooks/compensation.ipynb ## the documents as a site that needs no network: build/site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict --site-dir $(abspath $(BUILD))/site

# An axis that is stiffer than its machine file and has a ripple that is not in it.
picture: $(STAMP) ## the README's picture, docs/figures/first_screen.png, from simulate, estimate and diagnose; needs chromium
	@mkdir -p $(BUILD)/picture
	$(RUN) simulate docs/figures/rippled.toml --out $(BUILD)/picture/log.csv --trajectory mixed --scale stiffness=1.2 --duration 10
	$(RUN) estimate docs/figures/rippled.toml $(BUILD)/picture/log.csv --out $(BUILD)/picture/estimates.csv
	$(RUN) diagnose etel_xy $(BUILD)/picture/log.csv --out $(BUILD)/picture/diagnosis
	$(BIN)/python docs/figures/first_screen.py $(BUILD)/picture

notebooks: $(STAMP) ## examples/notebooks/*.ipynb from the scripts beside them
	$(BIN)/python docs/site/percent.py

# --- checks ----------------------------------------------------------------------------------------------------------

# One thread per worker: numerical libraries that each take all cores slow each other down. Bytecode is kept, whatever
# the environment says: to compile the tests takes longer than `make check` has.
PYTEST = PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS)

test: $(STAMP) ## all tests but those marked slow
	$(PYTEST) --dist worksteal -m "not slow" $(PYTEST_ARGS)

test-slow: $(STAMP) ## the tests marked slow
	$(PYTEST) --dist worksteal -m slow $(PYTEST_ARGS)

# Of their files alone: to import the others takes as long as these tests.
check: lint ## lint, types and the tests marked core: within a minute on two cores
	$(PYTEST) -m 'core and not slow' -q $(PYTEST_ARGS) $(shell grep -l 'mark\.core' tests/test_*.py)

lint: lint-ruff lint-format lint-types lint-c ## ruff, mypy --strict, clang-format: report, change nothing

lint-ruff: $(STAMP)
	$(BIN)/ruff check .

lint-format: $(STAMP)
	$(BIN)/ruff format --check .

lint-types: $(STAMP)
	$(BIN)/mypy

lint-c: $(STAMP)
	$(BIN)/clang-format --dry-run -Werror $(filter-out $(EMITTED_H),$(WRITTEN_C))
	$(BIN)/clang-format --dry-run -Werror --style=$(EMITTED_STYLE) $(EMITTED_H)

format: $(STAMP) ## let ruff and clang-format rewrite the sources
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(filter-out $(EMITTED_H),$(WRITTEN_C))
	$(BIN)/clang-format -i --style=$(EMITTED_STYLE) $(EMITTED_H)

# --- packaging -------------------------------------------------------------------------------------------------------

release-check: check-generated ## may this commit be tagged: version, changelog, generated/, nothing uncommitted
	@.ci/release-check

wheel: $(STAMP) ## dist/*.whl, made of dist/*.tar.gz: it carries templates, runtime C and machine files
	$(BIN)/python -m build --no-isolation

clean: ## remove what was built, keep .venv
	rm -rf $(BUILD) dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find generator bench tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## clean, and remove .venv
	rm -rf .venv
