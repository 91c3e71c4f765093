# make demo   plays the series-parallel scenario in real time
# make test   proves everything
# Each sets up what it needs: .venv, the locked dependencies, the package, the compiled kernels.

VENV := .venv
BIN := $(VENV)/bin
PYTHONS := python3.13 python3.12 python3.11 python3.14 python3 python
UV_VERSION := 0.13.9

# What tests need from the system (Debian's names); installed as root, otherwise named.
SYSTEM_PACKAGES := chromium chromium-driver can-utils iproute2 kmod mosquitto mosquitto-clients openssl tshark user-mode-linux

DEMO = $(BIN)/hev-can-emu scenario run scenarios/series_parallel.yaml --clock wall --bus socketcand --out out/demo
WARM = $(BIN)/hev-can-emu warm
PYTEST = $(BIN)/python -m pytest

# Stamps carry the content they stand for: the same content, the same stamp, nothing to do.
SOURCES := $(sort $(shell find hev_can_emu -name '*.py'))
KEY := $(shell { pwd; cat requirements.lock pyproject.toml hatch_build.py; } | cksum | cut -d' ' -f1)
CODE := $(shell cat $(SOURCES) | cksum | cut -d' ' -f1)
INSTALLED := $(VENV)/.installed-$(KEY)
WARMED := $(VENV)/.warmed-$(KEY)-$(CODE)

# The compiled kernels live in the user's cache folder; should that be gone, they are made anew.
CACHE := $(or $(HEV_CAN_EMU_CACHE),$(or $(XDG_CACHE_HOME),$(HOME)/.cache)/hev-can-emu)
ifeq ($(shell test -d "$(CACHE)" && echo there),)
.PHONY: $(WARMED)
endif

# Keeps the output of checks that run side by side apart, where this make can.
SYNC := $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)
QUIET_MAKE = $(MAKE) --no-print-directory

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
.PHONY: help install demo test system lint format types imports unit unit-interpreted unit-checked \
	unit-compiled socketcan wheel-smoke lock bench clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-18s %s\n", $$1, $$2 }' Makefile

install: $(INSTALLED) ## make .venv with the locked dependencies and the package (editable)

demo: $(WARMED) ## play the series-parallel scenario in real time, leave plot and recording in out/demo
	@$(DEMO)

test: $(WARMED) system ## run every check: lint, types, imports, all tests with coverage
	@status=0; \
	$(QUIET_MAKE) -k -j2 $(SYNC) unit-interpreted unit-checked types lint imports || status=$$?; \
	$(QUIET_MAKE) unit-compiled || status=$$?; \
	$(QUIET_MAKE) socketcan || status=$$?; \
	exit $$status

lint: $(INSTALLED) ## check style and formatting
	@$(BIN)/ruff check --output-format concise .
	@$(BIN)/ruff format --check .

format: $(INSTALLED) ## format the code, mend what can be mended
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

types: $(INSTALLED) ## check types, strictly
	@$(BIN)/mypy

imports: $(INSTALLED) ## check that imports point downward
	@$(BIN)/lint-imports --no-logo

unit: unit-interpreted ## run all tests with coverage of compiled and plain code
	@$(QUIET_MAKE) unit-compiled

# Coverage does not see compiled bodies: these run as plain Python.
unit-interpreted: $(INSTALLED) ## run the kernels' tests without the compiler, for coverage
	@echo "== kernels as plain Python"
	@NUMBA_DISABLE_JIT=1 $(PYTEST) -q -m "kernels and not realtime" --cov --cov-report=

# A read past an array's end gives silent rubbish in compiled code, unless checked.
unit-checked: $(INSTALLED) ## run the kernels' tests compiled with bounds checks
	@echo "== kernels with bounds checks"
	@NUMBA_BOUNDSCHECK=1 $(PYTEST) -q -m "kernels and not realtime"

# Adds to the coverage of unit-interpreted. Tests of wall-clock time have the machine to themselves.
unit-compiled: $(WARMED)
	@status=0; \
	echo "== tests of wall-clock time"; \
	$(PYTEST) -q -m realtime --cov --cov-append --cov-report= || status=$$?; \
	echo "== all other tests"; \
	$(PYTEST) -q -n 2 --dist loadgroup -m "not realtime and not socketcan" --cov --cov-append --cov-report=term \
		--durations 5 --durations-min 5 || status=$$?; \
	exit $$status

socketcan: $(WARMED) system ## run the bus tests on a real kernel's vcan0: the host's, or user-mode Linux
	@echo "== SocketCAN on a real kernel"
	@$(BIN)/python tests/socketcan/stage.py

wheel-smoke: $(WARMED) ## build the wheel and try it in a fresh environment
	@$(PYTEST) -q -m wheel

bench: $(WARMED) ## measure; figures go to the terminal
	@for bench in benchmarks/[a-z]*.py; do echo "== $$bench"; $(BIN)/python $$bench || exit 1; done

lock: $(INSTALLED) ## lock the dependencies anew (UPGRADE=1: to their latest releases)
	@$(BIN)/python -m pip install -qq --disable-pip-version-check uv==$(UV_VERSION)
	@$(BIN)/uv pip compile pyproject.toml --quiet --universal --python-version 3.11 --fork-strategy fewest \
		--all-extras --group dev --generate-hashes --no-emit-index-url --no-header \
		$(if $(UPGRADE),--upgrade) --output-file requirements.lock

clean: ## remove what was built and measured, keep .venv
	@rm -rf build dist out htmlcov .coverage .coverage.* .pytest_cache .mypy_cache .ruff_cache .hypothesis \
		.import_linter_cache

system:
	@missing=; for package in $(SYSTEM_PACKAGES); do \
		dpkg -s $$package >/dev/null 2>&1 || missing="$$missing $$package"; \
	done; \
	if test -z "$$missing"; then :; \
	elif test "$$(id -u)" -eq 0 && command -v apt-get >/dev/null; then \
		apt-get update -qq && apt-get install -qq -y --no-install-recommends $$missing; \
	else echo "tests need system packages: as root, apt-get install$$missing" >&2; exit 1; fi

# A .venv of another Python, or one that was moved here, is made anew.
$(INSTALLED):
	@if ! $(BIN)/python -c 'import sys, pip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
		|| ! grep -qF "$(CURDIR)/$(VENV)/bin/python" $(BIN)/pip; then \
		found=; for python in $(PYTHON) $(PYTHONS); do \
			"$$python" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))' \
				2>/dev/null && found="$$python" && break; \
		done; \
		if test -z "$$found"; then \
			echo "no Python 3.11 or newer with venv found (tried $(PYTHON) $(PYTHONS)); install one (Debian: python3-venv) or name it: make PYTHON=/path/to/python3" >&2; \
			exit 1; \
		fi; \
		echo "Making $(VENV) with $$("$$found" --version)"; \
		rm -rf $(VENV) && "$$found" -m venv $(VENV) || exit 1; \
	fi
	@echo "Installing the locked dependencies (a minute or two the first time)"
	@# The lock is whole: with --no-deps pip looks for nothing newer that an extra might name.
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --require-hashes --no-deps \
		--only-binary :all: --requirement requirements.lock
	@echo "Installing hev-can-emu"
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --no-index --no-deps \
		--no-build-isolation --editable .
	@$(BIN)/python -m pip --disable-pip-version-check check >/dev/null || $(BIN)/python -m pip check
	@rm -f $(VENV)/.installed-* && touch $@

$(WARMED): $(INSTALLED) $(SOURCES)
	@$(WARM)
	@rm -f $(VENV)/.warmed-* && touch $@
