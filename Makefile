# `make demo` and `make test` install what they need into .venv, with uv if it is installed, otherwise with venv and pip.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# What the tests need; .ci/run adds view, whose wheels are 225 MB.
EXTRAS ?= dev
UV := $(shell command -v uv 2>/dev/null)

.PHONY: demo test slow check clean

demo: $(VENV)/.installed
	$(BIN)/mapmend demo -o demo

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "not slow"

slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell

$(BIN)/python:
ifneq ($(UV),)
	$(UV) venv --python '>=3.11' $(VENV)
else
	$(PYTHON) -m venv $(VENV)
endif

$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
ifneq ($(UV),)
	$(UV) pip install --python $(BIN)/python -c constraints.txt -e .
else
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
endif
	touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(BIN)/python
ifneq ($(UV),)
	$(UV) pip install --python $(BIN)/python -c constraints.txt -e '.[$(EXTRAS)]'
else
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[$(EXTRAS)]'
endif
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) build demo .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
