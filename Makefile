# `make run` sets everything up in .venv and inserts a peg; `make test` sets up the tests and runs them.
# What can be set on the command line:
#   PYTHON       the interpreter to build .venv with (3.11 or newer):  make run PYTHON=python3.12
#   TORCH        the PyTorch to install, as pip names it:              make run TORCH=torch
#   TORCH_INDEX  the package index to take PyTorch from, such as PyTorch's own index of CPU builds; pip's default if empty

PYTHON ?= python3
TORCH ?= $(shell grep '^torch==' constraints.txt)
TORCH_INDEX ?=

BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
PLUGINS := $(wildcard plugins/*/pyproject.toml)
TEMPLATES := region neuron code rule body command
# The tests that are about what calls the C code; whole experiments and devices on top of it would only be slow.
NATIVE := $(addprefix tests/,codes engine experiment graph interchange learning measures neurons plasticity regions synapses tasks)
SANITIZERS := -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer

.DEFAULT_GOAL := help
.PHONY: help run train test sanitize check docs clean python

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-9s%s\n", $$1, $$2}' Makefile

run: .venv/.installed ## set up, then insert a peg with the spiking brain and save a recording
	$(BIN)/neurorobo run examples/peg_in_hole.yaml

train: .venv/.installed ## train the three brain regions from scratch (about 15 minutes; stop and go on at will)
	$(BIN)/neurorobo train examples/peg_in_hole.yaml

test: .venv/.installed-dev ## set up, then run the tests
	$(BIN)/pytest

# The second library is for the exceptions that torch throws and catches. What Python leaks is not of interest.
sanitize: .venv/.installed-dev ## run the tests that use the C code under the address and undefined-behaviour sanitizers
	rm -rf build/sanitized
	CC='$(CC)' CFLAGS='$(SANITIZERS)' LDFLAGS='$(SANITIZERS)' $(BIN)/python setup.py --quiet build_ext \
	  --build-temp build/sanitized/objects --build-lib build/sanitized
	LD_PRELOAD="$$($(CC) -print-file-name=libasan.so) $$($(CC) -print-file-name=libstdc++.so)" ASAN_OPTIONS=detect_leaks=0 \
	  NEUROROBO_LIBRARIES='$(CURDIR)/build/sanitized/neurorobo/engine' NEUROROBO_ENGINE=native NEUROROBO_FUZZ=100 $(BIN)/pytest $(NATIVE)

check: .venv/.installed-dev ## lint, types (also of what `neurorobo new` makes), layers, schema, examples and documentation
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	rm -rf build/new
	for kind in $(TEMPLATES); do $(BIN)/neurorobo new $$kind try_$$kind --out build/new/$$kind >/dev/null || exit 1; done
	$(BIN)/mypy build/new
	$(BIN)/lint-imports
	$(BIN)/neurorobo schema --check docs/schema/experiment.schema.json
	$(BIN)/neurorobo validate examples/*.yaml
	rm -rf docs/reference/api # it is generated, and may hold pages of modules that are no more
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs build/docs

docs: .venv/.installed-dev ## build the documentation into build/docs
	rm -rf docs/reference/api # it is generated, and may hold pages of modules that are no more
	$(BIN)/sphinx-build --fail-on-warning --keep-going docs build/docs
	@echo "open build/docs/index.html"

clean: ## remove all that make has made, .venv included; runs are kept
	rm -rf .venv build *.egg-info plugins/*/*.egg-info plugins/*/build
	rm -rf .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache

python:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "There is no '$(PYTHON)' on this machine. Install Python 3.11 or newer, or name it with PYTHON=/path/to/python3"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "neurorobo needs Python 3.11 or newer, and '$(PYTHON)' is $$($(PYTHON) -V). Name a newer one with PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "'$(PYTHON)' lacks the modules venv and ensurepip. On Debian and Ubuntu: apt install python3-venv"; exit 1; }

# PyTorch comes first and alone, so that nothing else can choose another build of it. Afterwards the version found is pinned.
.venv/.torch: constraints.txt | python
	$(PYTHON) -m venv .venv
	$(PIP) install --no-deps $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) '$(TORCH)'
	@$(BIN)/python -c 'import importlib.util, runpy; \
	  build = runpy.run_path(importlib.util.find_spec("torch").origin.replace("__init__.py", "version.py")); \
	  print("PyTorch", build["__version__"], "with CUDA " + build["cuda"] if build["cuda"] else "without CUDA")'
	@{ grep -v '^torch==' constraints.txt; \
	  $(BIN)/python -c 'from importlib.metadata import version; print("torch==" + version("torch"))'; } > .venv/constraints.txt
	@touch $@

.venv/.installed: .venv/.torch pyproject.toml setup.py neurorobo/engine/native.c neurorobo/engine/models.h $(PLUGINS)
	$(PIP) install -c .venv/constraints.txt -e . $(PLUGINS:%/pyproject.toml=-e %)
	@touch $@

.venv/.installed-dev: .venv/.installed
	$(PIP) install -c .venv/constraints.txt -e '.[dev]'
	$(PIP) install -c .venv/constraints.txt --no-deps neurobench # of its dependencies, its metrics need only what is there
	@touch $@
