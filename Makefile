# PointMR: `make render` makes a picture, `make test` runs the tests; both set up .venv themselves.
#   make render BLEND=my.blend ARGS="--method conventional --size 640x480"

BLEND ?= scenes_blend/still_life.blend
OUT   ?= out
ARGS  ?=
VENV  ?= .venv
JOBS  ?= 2
PYTHON ?= $(firstword $(shell command -v python3.11 python3 2>/dev/null))

BIN   := $(VENV)/bin
# tests run in JOBS processes: most of a test is one thread's work (compiling, Python); a file stays in one process
PYTEST := $(VENV)/bin/python -m pytest -q -n $(JOBS) --dist loadfile
PIP   := $(BIN)/python -m pip --disable-pip-version-check --quiet install --prefer-binary
STAMP := $(VENV)/.pointmr

.PHONY: render test test-all lint bench setup clean help
.DEFAULT_GOAL := help

help:
	@echo "make render    render $(BLEND) to $(OUT)/ (BLEND=..., ARGS='--method raytrace --cones 4')"
	@echo "make test      lint and quick tests       make test-all  every test (JOBS=$(JOBS) processes)"
	@echo "make bench     error against time, beside Cycles, to $(OUT)/judge/"
	@echo "make clean     remove out/, caches and compiled kernels (not .venv)"

render: $(STAMP)-render
	$(BIN)/pointmr render "$(BLEND)" -o "$(OUT)/$(basename $(notdir $(BLEND))).exr" --png $(ARGS)

test: lint
	$(PYTEST) -m "not slow" $(ARGS)

test-all: lint
	$(PYTEST) $(ARGS)

lint: $(STAMP)-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

bench: $(STAMP)-bench
	$(BIN)/python -m benchmarks.judge $(or $(ARGS),$(BLEND) --methods raytrace:1,4 distributed:4,16,64 cycles:4,16,64 conventional)

setup: $(STAMP)-render $(STAMP)-test

# What is installed for which purpose; a stamp makes the second call instant.
$(STAMP)-render: EXTRAS := blender,cli
$(STAMP)-test:   EXTRAS := blender,cli,test
$(STAMP)-bench:  EXTRAS := blender,cli,bench

$(STAMP)-render $(STAMP)-test $(STAMP)-bench: pyproject.toml | $(BIN)/python
	@echo "installing PointMR [$(EXTRAS)] into $(VENV) (bpy is 350 MB: the first time takes a few minutes)"
	@$(PIP) -e ".[$(EXTRAS)]"
	@$(BIN)/python -c "import bpy" || { echo "Blender's Python module does not load: see README.md, 'System libraries'"; exit 1; }
	@touch $@

$(BIN)/python:
	@"$(PYTHON)" -c "import sys; sys.exit(sys.version_info[:2] != (3, 11))" 2>/dev/null || \
	  { echo "Python 3.11 is needed (bpy 5.0 is built for it), found: $$($(PYTHON) --version 2>&1); set PYTHON=..."; exit 1; }
	@"$(PYTHON)" -m venv "$(VENV)"

clean:
	rm -rf "$(OUT)" build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find pointmr_engine blender_addon benchmarks tests -name __pycache__ -prune -exec rm -rf {} +
