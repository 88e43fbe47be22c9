# Everything here starts from nothing but make and a Python: the environment is made in .venv, from the exact versions
# in requirements.lock. A change of pyproject.toml or of the lock installs again, and an environment that cannot be used
# as it is (see STALE) is made again.

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input --quiet
CANDIDATES := $(or $(PYTHON),python3 python3.13 python3.12 python3.11 python3.10 python)
PACKAGES := $(wildcard zmav agents mesh ground tests docs)
BENCHES := $(filter-out tests/bench/_%,$(sort $(wildcard tests/bench/*.py)))
BENCHES += "-m tests.bench.controllers" "-m tests.bench.scale 10 30"
CORES := $(shell getconf _NPROCESSORS_ONLN)
WARM := $(BIN)/python -c 'from agents.planner.solve.warm import warm; warm()'
TYPES := $(BIN)/mypy --strict $(PACKAGES)
PYTEST_JOBS ?= $(shell expr $(CORES) + 4)
ARGS ?=
TSC := $(shell command -v tsc || ls node_modules/.bin/tsc 2>/dev/null)

# Stale: its Python is gone, was upgraded or is not the one asked for by PYTHON=; it was made for a tree elsewhere (its
# scripts hold that path); or something was cut short, which leaves .made unwritten or .installing behind.
IDENTIFY := -c 'import sys; print("%d.%d.%d" % sys.version_info[:3], sys.base_prefix)'
HAVE := $(shell $(BIN)/python $(IDENTIFY) 2>/dev/null)
WANT := $(if $(PYTHON),$(shell $(PYTHON) $(IDENTIFY) 2>/dev/null),$(HAVE))
MADE := $(shell cat $(VENV)/.made 2>/dev/null)
STALE := $(wildcard $(VENV)/.installing)
ifneq ($(MADE),$(CURDIR) $(WANT))
  STALE := yes
endif

# Without compiled modules every process that a test starts takes a second of a core longer, and so does each worker's
# look for tests by twenty.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo planner vision test prepare check fuzz lint style docs kernels conformance bench lock dist site clean FORCE

help: ## say what can be made (the default)
	@echo "zmav: MAVLink over Zenoh. What can be made, each from nothing but Python 3.10 or newer:"
	@sed -n 's/^\([a-z]*\):.*## /  make \1|/p' Makefile | awk -F'|' '{ printf "%-14s %s\n", $$1, $$2 }'
	@echo
	@echo "  PYTHON=python3.12   the Python to make .venv with"
	@echo "  ARGS='-k frames'    more arguments for the demo, or for pytest"
	@echo "  PYTEST_JOBS=1       how many tests run side by side (default: four more than there are cores, as most of them wait)"

# The plain demo needs no compiler and no OpenCV, which are half of all; what another does its file says, beside what the
# plain one has. One's own may need all.
DEMO := $(firstword $(filter-out -%,$(ARGS)) line)
NEEDS := $(if $(wildcard deploy/demos/$(DEMO).toml),$(filter-out interpreted,$(shell sed -n 's/^needs = \[\(.*\)\].*/\1/p' \
    deploy/demos/$(DEMO).toml | tr -d '",')),planner vision)

# It ends with make, even where that is killed.
demo: $(if $(NEEDS),$(NEEDS:%=$(VENV)/.demo-%),$(VENV)/.demo) ## fly a demo fleet: three copters behind three linked routers, or ARGS=swap, ARGS=--list
	@echo "==> zmav demo $(ARGS)"
	@exec $(BIN)/python -I -S zmav/guard.py $$PPID $(BIN)/zmav demo $(ARGS)

planner: $(VENV)/.demo-planner ## add the planner's compiler to what the plain demo needs: for 'zmav swarm planner', 'zmav plan'

vision: $(VENV)/.demo-vision ## add OpenCV to it: for cameras and the helipad

# Types are checked beside the tests, which often wait for something, at the lowest priority.
test: style $(if $(filter yes,$(PREPARED)),,prepare) ## check style, format and types, and run every test
	@echo "==> pytest, $(PYTEST_JOBS) at a time, with $$($(BIN)/python --version), and mypy --strict beside it"
	@$(BIN)/python tests/run.py --beside '$(TYPES)' -n $(PYTEST_JOBS) --dist worksteal --durations 10 $(ARGS)

# Else each of the workers compiles both the kernels and the modules, and they begin together. Tests are compiled by pytest
# alone, as it looks for them: those that changed since it last did.
prepare: $(VENV)/.dev ## compile what the tests use; then 'make test PREPARED=yes'
	@touch $(VENV)/.compiling; \
	    changed=$$(find tests \( -name 'test_*.py' -o -name conftest.py \) \
	        $(if $(and $(wildcard tests/__pycache__),$(wildcard $(VENV)/.compiled)),-newer $(VENV)/.compiled)); \
	    { $(BIN)/python -m compileall -q -x '/(test_\w+|conftest)\.py' $(PACKAGES); [ -z "$$changed" ] || \
	        $(BIN)/python -m pytest --collect-only -qq $$changed; } > /dev/null 2>&1 & modules=$$!; \
	    $(WARM); compiled=$$?; wait $$modules || :; mv $(VENV)/.compiling $(VENV)/.compiled; exit $$compiled

# The daemon of mypy keeps what it knows of the tree. Where it does not run, or finds something (now and then what is no
# error), mypy itself decides. Unit tests wait for nothing: as many at a time as there are cores.
check: style ## lint, then run the short unit tests and those that use what changed since the merge base: BASE=main
	@echo "==> dmypy run"
	@$(BIN)/dmypy run -- --strict $(PACKAGES) > /dev/null || $(TYPES)
	@BASE='$(BASE)' $(BIN)/python tests/check.py -q -n $(CORES) --dist worksteal $(ARGS)

fuzz: $(VENV)/.dev ## give all that takes bytes spoilt ones, longer than 'test' does: ARGS='--seconds 60 --seed 7 mcap http'
	@$(BIN)/python -m tests.fuzz $(ARGS)

lint: style ## check style, format and types
	@echo "==> mypy --strict"
	@$(TYPES)

style: $(VENV)/.dev
	@echo "==> ruff check"
	@$(BIN)/ruff check .
	@echo "==> ruff format --check"
	@$(BIN)/ruff format --check .
	@if [ -n "$(TSC)" ]; then echo "==> tsc --checkJs --strict"; $(TSC) -p ground/http/static/tsconfig.json; \
	    else echo "==> the page's types are left out: no tsc here (npm install --no-save typescript)"; fi

docs: $(VENV)/.dev ## write docs/keys.md, docs/cli.md and the orders in docs/credentials.md again
	@$(BIN)/python docs/generate.py

kernels: $(VENV)/.dev ## compile the planner for this machine (half a minute of a core, once; else its first run does)
	@echo "==> compiling the planner's kernels where they are not yet"
	@$(WARM)

conformance: $(VENV)/.dev ## fly the conformance suite: LINK=tcp:127.0.0.1:5760 (default: the simulator)
	@echo "==> conformance of $(or $(LINK),the simulated autopilots)"
	@ZMAV_LINK='$(LINK)' $(BIN)/python -m pytest tests/conformance -v $(ARGS)

bench: $(VENV)/.dev ## run every benchmark in tests/bench, or one: ARGS=companion, ARGS='adapter --rounds 3'
	@failed=; for script in $(if $(ARGS),tests/bench/$(firstword $(ARGS)).py,$(BENCHES)); do \
	    echo "==> $$script"; \
	    $(BIN)/python $$script $(wordlist 2,$(words $(ARGS)),$(ARGS)) || failed="$$failed $$script"; \
	done; \
	if [ -n "$$failed" ]; then echo "==> failed:$$failed" >&2; exit 1; fi

lock: ## renew requirements.lock (needs uv)
	@echo "==> resolving the newest versions for every Python from 3.10 up"
	@UV_CUSTOM_COMPILE_COMMAND="make lock" uv pip compile --upgrade --universal --python-version 3.10 --all-extras \
	    --generate-hashes \
	    --no-emit-index-url --no-emit-find-links --quiet --output-file requirements.lock pyproject.toml

dist: $(VENV)/.dev ## build wheel and sdist, twice, try the wheel with every Python from 3.10 to 3.13 here, write a bill of materials
	@$(BIN)/python deploy/dist.py $(ARGS)

site: $(VENV)/.site ## build the site into build/site; versions of it: mike deploy VERSION
	@NO_MKDOCS_2_WARNING=1 PATH="$(BIN):$$PATH" $(BIN)/mkdocs build --strict $(ARGS)

clean: ## remove .venv and what the tools left behind
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist
	find $(PACKAGES) -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.demo: $(VENV)/.made pyproject.toml requirements.lock
	$(call install,interpreted ground,zmav with what the plain demo needs)
	@touch $@

$(VENV)/.demo-%: $(VENV)/.made pyproject.toml requirements.lock
	$(call install,interpreted ground $*,zmav with what the demo needs and its $*)
	@touch $(VENV)/.demo $@

$(VENV)/.site: $(VENV)/.made pyproject.toml requirements.lock
	$(call install,site,zmav and what builds its site)
	@touch $@

$(VENV)/.dev: $(VENV)/.made pyproject.toml requirements.lock
	$(call install,dev,zmav and its development tools)
	@touch $(VENV)/.demo $(VENV)/.demo-planner $(VENV)/.demo-vision $@

# Nothing is downloaded but what the lock has a hash of, and nothing of others is built here: our own is, with tools from
# the lock. pip would compile every dialect pymavlink has, which takes longer than all the rest; the import compiles the
# one in use.
define install
@echo "==> installing $(2) into $(VENV), versions as in requirements.lock (up to a minute the first time)"
@touch $(VENV)/.installing
@$(BIN)/python deploy/needed.py build $(1) > $(VENV)/needed.txt
@$(PIP) install --no-compile --require-hashes --only-binary :all: -r $(VENV)/needed.txt
@$(PIP) install --no-compile --no-deps --no-build-isolation -e .
@$(BIN)/python -c 'import numpy, rich, zenoh, pymavlink.dialects.v20.ardupilotmega'
@rm -f $(VENV)/.installing $(VENV)/.compiled
endef

# Takes the first candidate that will do; if none will, says what is wrong with each. A 32-bit system may run on a 64-bit
# kernel, as Raspberry Pi OS does: 'uname -m' tells the kernel's.
$(VENV)/.made: $(if $(STALE),FORCE)
	@if [ "$$(getconf LONG_BIT 2>/dev/null)" = 32 ]; then \
	    echo "==> 64-bit only: this system is 32-bit, for which msgspec, numpy and OpenCV have no wheels" \
	        "(on a Raspberry Pi, install the 64-bit system)" >&2; \
	    exit 1; \
	fi
	@chosen=; found=; \
	for python in $(CANDIDATES); do \
	    version=$$($$python -c 'import platform; print(platform.python_version())' 2>/dev/null) || continue; \
	    if ! $$python -c 'import sys; sys.exit(sys.version_info < (3, 10))'; then \
	        found="$$found\n    $$python is Python $$version"; \
	    elif ! $$python -c 'import sys; sys.exit(sys.maxsize < 2**32)'; then \
	        found="$$found\n    $$python (Python $$version) is a 32-bit program, and zmav is 64-bit only"; \
	    elif ! $$python -c 'import ensurepip, venv' 2>/dev/null; then \
	        found="$$found\n    $$python (Python $$version) lacks venv or ensurepip; Debian and Ubuntu: apt install python3-venv"; \
	    else chosen=$$python; break; fi; \
	done; \
	if [ -z "$$chosen" ]; then \
	    printf "==> zmav needs Python 3.10 or newer, with venv; set PYTHON=/path/to/python3. Looked for: %s\n" \
	        "$(CANDIDATES)" >&2; \
	    [ -z "$$found" ] || printf "Found only:$$found\n" >&2; \
	    exit 1; \
	fi; \
	echo "==> making $(VENV) with Python $$version ($$(command -v $$chosen))"; \
	rm -rf $(VENV) && $$chosen -m venv $(VENV)
	@echo "$(CURDIR) $$($(BIN)/python $(IDENTIFY))" > $@

FORCE:
