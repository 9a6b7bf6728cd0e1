# Every task a person runs. `make help` lists them. Each works alone and first on a fresh clone:
# what is missing is installed (system packages with apt where permitted, Python packages into .venv).

.DEFAULT_GOAL := help
SHELL := /bin/sh
PYTHON ?= python3
export PYTHON
VENV := .venv
BIN := $(VENV)/bin
TIGER := $(BIN)/tiger
JOBS ?= 2
PYTEST := $(BIN)/pytest -q
# Small matrices everywhere: threads inside the linear algebra only get in each other's way.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

SCENARIO ?= shaking-plate
DURATION ?= 60

CXX_SOURCES := $(shell git ls-files 'firmware/*.h' 'firmware/*.cpp' 'firmware/*.ino' 'tests/*.h' 'tests/*.c' 'tests/*.cpp' 2>/dev/null | grep -v tiger/protocol.h)
NATIVE_SOURCES := $(shell find firmware/libraries/TigerCore firmware/native -name '*.h' -o -name '*.cpp')
SPEC := protocol/tiger.toml protocol/spec.py protocol/generate.py $(wildcard protocol/templates/*)
PY_SOURCES := host protocol tests bench firmware scripts setup.py

include firmware/avr.mk

.PHONY: help
help: ## List the tasks
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

# ---------------------------------------------------------------------------------------------------- set-up

.PHONY: setup
setup: $(VENV)/.native ## Make .venv with everything the host needs

.PHONY: system-host system-avr
system-host:
	@scripts/system-packages.sh host
system-avr:
	@scripts/system-packages.sh avr

$(VENV)/.installed: pyproject.toml constraints.txt setup.py | system-host
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing Python packages into $(VENV) (about a minute)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
	  --editable '.[sim,cluster,logs,dev]'
	@touch $@ $(VENV)/.native

# The boards on virtual pins: compiled again whenever a firmware source changes (the install has just done it once).
$(VENV)/.native: $(VENV)/.installed $(NATIVE_SOURCES) host/tiger/native/build.py
	@if [ -n "$$(find $? -newer $@ 2>/dev/null)" ] || [ ! -e $@ ]; then \
	  echo "Compiling the native boards" && $(BIN)/python host/tiger/native/build.py >/dev/null; fi
	@touch $@

# ------------------------------------------------------------------------------------------------------- use

.PHONY: run
run: setup ## Bring up the emulated robot on its shaking plate and level it (SCENARIO=, DURATION=)
	@$(TIGER) run --emulate $(SCENARIO) --duration $(DURATION)

.PHONY: generate
generate: setup ## Write both sides of the wire from protocol/tiger.toml, and the pages made from tables and models
	@$(BIN)/python protocol/generate.py
	@$(BIN)/python scripts/render_safety.py
	@$(BIN)/python scripts/render_api.py

# ------------------------------------------------------------------------------------------------------ tests

.PHONY: test
test: check system-avr ## Check and run every test, the AVR images in the simulator included
	@$(MAKE) --no-print-directory firmware
	$(PYTEST) -n $(JOBS) --dist loadfile -m "not proof and not realtime"
	$(PYTEST) -m "realtime and not proof"

.PHONY: test-host
test-host: check ## Check and run every test that needs no AVR toolchain
	$(PYTEST) -n $(JOBS) --dist loadfile -m "not proof and not realtime and not avr"
	$(PYTEST) -m "realtime and not proof and not avr"

.PHONY: proof
proof: setup system-avr ## Run what is too long for `make test`; figures go to docs/proof.md
	@$(MAKE) --no-print-directory firmware
	$(PYTEST) -n $(JOBS) --dist load -m "proof and not realtime" --timeout 7200 --proof-page docs/proof.md
	$(PYTEST) -m "proof and realtime" --timeout 7200 --proof-page docs/proof.md

.PHONY: bench
bench: setup ## Measure speed against named peers in the same run
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[bench]'
	@for script in bench/*.py; do case $$script in */_*) ;; *) echo "== $$script"; $(BIN)/python $$script || exit 1;; esac; done

.PHONY: check
check: setup ## Formatters, linters, types, import rules, generated files
	@$(BIN)/ruff format --check $(PY_SOURCES)
	@$(BIN)/ruff check $(PY_SOURCES)
	@$(BIN)/clang-format --dry-run --Werror $(CXX_SOURCES)
	@$(BIN)/mypy
	@$(BIN)/lint-imports --config pyproject.toml
	@$(BIN)/python protocol/generate.py --check
	@$(BIN)/python scripts/render_safety.py --check
	@$(BIN)/python scripts/render_api.py --check

.PHONY: format
format: setup ## Format all sources in place
	@$(BIN)/ruff format $(PY_SOURCES)
	@$(BIN)/ruff check --fix-only $(PY_SOURCES)
	@$(BIN)/clang-format -i $(CXX_SOURCES)

.PHONY: clean
clean: ## Remove what was built; .venv stays (distclean removes it too)
	rm -rf build out .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find host protocol tests -name __pycache__ -prune -exec rm -rf {} +
	rm -f host/tiger/native/_core*.so host/tiger/native/_core.c* $(VENV)/.native

.PHONY: distclean
distclean: clean
	rm -rf $(VENV)
