# Everything runs in .venv, which is made on first use.
PYTHON ?= $(or $(shell command -v python3.11),$(shell command -v python3))
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test check clean

demo: $(VENV)/done ## replay a recording, and run the node on one over DDS
	$(BIN)/python examples/demo.py

test: $(VENV)/done ## every check and every test
	$(MAKE) --no-print-directory lint
	$(BIN)/python -m pytest

check: $(VENV)/done ## the fast ones, without ROS
	$(MAKE) --no-print-directory lint
	$(BIN)/python -m pytest -m "not ros and not slow"

.PHONY: lint
lint: $(VENV)/done
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

$(VENV)/done: setup.py package.xml
	@echo "Installing into $(VENV) (a minute or two, once)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[ros,test]'
	@touch $@

clean: ## forget the environment, what was compiled and what the demo wrote
	rm -rf $(VENV) demo build install log *.egg-info .*_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
