# Python 3.11 or later is all that must be there; the rest goes into .venv. The newest that is found is taken, or PYTHON=python3.12.
# For torch's CPU-only wheels: make train TORCH_ARGS="--index-url https://download.pytorch.org/whl/cpu"

PYTHON ?= $(shell for p in python3.14 python3.13 python3.12 python3.11; do $$p -c '' 2>/dev/null && echo $$p && break; done || echo python3)
PIP := .venv/bin/python -m pip install -qq --disable-pip-version-check --root-user-action=ignore
ARGS ?=
# variables of this file; all others that are given on the command line are settings of pmil train
OF_MAKE := PYTHON PIP ARGS TORCH_ARGS SOAK_RUNS SOAK_SEED MAKEFLAGS MAKEOVERRIDES -*-command-variables-*-
GIVEN = $(foreach name,$(sort $(filter-out $(OF_MAKE),$(.VARIABLES))),$(if $(filter command,$(origin $(name))),$(name)='$($(name))'))
TORCH_ARGS ?=
SOAK_RUNS ?= 100
SOAK_SEED ?= 0
CPU := https://download.pytorch.org/whl/cpu
# the matrices are small: more threads wait for each other
export OMP_NUM_THREADS ?= 1
# else each process of the tests compiles all modules and assertions anew
unexport PYTHONDONTWRITEBYTECODE
NUMERICAL := tests/gp tests/control tests/model tests/search tests/trainer tests/test_reference.py
PORTABLE := ATEN_CPU_CAPABILITY=default MKL_CBWR=COMPATIBLE OPENBLAS_CORETYPE=Nehalem \
  NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=

.DEFAULT_GOAL := help
.PHONY: help train test test-ci test-portable test-all test-newest lint demonstrations results evidence reproduce arms soak docs benchmark benchmark-steps dist test-dist test-wheel clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1 - /p' Makefile

train: .venv/.installed  ## learn the double pendulum task into runs/double_pendulum; settings as seed=1 trials=2
	@.venv/bin/pmil train $(strip $(GIVEN) $(ARGS))

test: .venv/.installed  ## the tests of the mathematics, the trainer and the commands
	@.venv/bin/python -m pytest -n 2 $(ARGS)

test-ci: .venv/.installed  ## what CI runs besides: robots, the paper's experiments, documents and notebooks
	@.venv/bin/python -m pytest -n 2 -m "(robot or docs or browser) and not slow" $(ARGS)

test-portable: .venv/.installed  ## the numerical tests as a processor without AVX computes them
	@$(PORTABLE) .venv/bin/python -m pytest -n 2 $(NUMERICAL) $(ARGS)

test-all: .venv/.installed  ## all tests, the slow ones too
	@.venv/bin/python -m pytest -n 2 -m "" $(ARGS)

# what a coming torch warns of is printed, and fails nothing
test-newest:  ## the fast tests with the newest torch, in an environment of its own in build/newest; not part of CI
	@rm -rf build/newest && mkdir -p build/newest
	@echo "Building build/newest/.venv; this takes a few minutes."
	@$(PYTHON) -m venv build/newest/.venv
	@cd build/newest && $(PIP) --extra-index-url $(CPU) -e "$(CURDIR)[test]"
	@cd build/newest && $(PIP) --index-url $(CPU) --upgrade torch
	@build/newest/.venv/bin/python -c "import torch; print('torch', torch.__version__)"
	@build/newest/.venv/bin/python -m pytest -n 2 -W default::FutureWarning $(ARGS)

lint: .venv/.installed  ## check style, formatting and types
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@.venv/bin/mypy

demonstrations: .venv/.installed  ## record the demonstrations of the double pendulum anew
	@.venv/bin/python scripts/record_demonstrations.py $(ARGS)

results: .venv/.installed  ## learn five tasks with the seeds 0-9, the first with 0-29, resumable
	@.venv/bin/python -m reproduction.shipped_tasks

evidence: .venv/.benchmark arms  ## make every result of other sources anew, resumable, in many hours; ARGS=--list says which
	@.venv/bin/python -m reproduction.evidence $(ARGS)

reproduce: .venv/.installed  ## reproduce an experiment of the paper, as ARGS="figure6" or ARGS="figure6 --quick"
	@.venv/bin/python scripts/reproduce.py $(ARGS)

arms: .venv/.installed  ## models of UR5e and Panda (robosuite, 157 MB), which make reproduce ARGS=ur5e needs
	@$(PIP) --no-deps robosuite==1.5.2

soak: .venv/.installed  ## learn SOAK_RUNS=100 runs of eight tasks from SOAK_SEED=0 on, resumable, into results/soak
	@.venv/bin/python scripts/soak.py --runs $(SOAK_RUNS) --first-seed $(SOAK_SEED) $(ARGS)

docs: .venv/.docs  ## build the documentation into docs/_build/html, its notebooks executed
	@.venv/bin/python -m sphinx -b html -q -W --keep-going -E docs docs/_build/html

benchmark: .venv/.benchmark  ## time and memory of predictions (beside TorchRL's), of fits and of a policy's step, into results
	@.venv/bin/python -m benchmarks.prediction $(ARGS)
	@.venv/bin/python -m benchmarks.breakdown
	@.venv/bin/python -m benchmarks.gp_fit
	@.venv/bin/python -m benchmarks.dimensions
	@.venv/bin/python -m benchmarks.policy_step

benchmark-steps: .venv/.benchmark  ## time of single steps
	@.venv/bin/python -m pytest benchmarks/test_single_steps.py $(ARGS)

dist: .venv/.dev  ## build a source archive and a wheel into dist/, and check what they hold
	@rm -rf dist
	@PIP_CONSTRAINT=$(CURDIR)/constraints.txt .venv/bin/python -m build -q --outdir dist .
	@.venv/bin/python scripts/check_dist.py dist

test-dist: dist  ## the fast tests against the wheel, installed into an environment of its own in build/dist
	@rm -rf build/dist && mkdir -p build/dist
	@tar -xzf dist/*.tar.gz -C build/dist --strip-components 1
	@rm -r build/dist/torch_pmil
	@echo "Building build/dist/.venv with the wheel; this takes a few minutes."
	@$(PYTHON) -m venv build/dist/.venv
	@cd build/dist && $(PIP) $(TORCH_ARGS) -c constraints.txt torch==2.13.0
	@cd build/dist && $(PIP) -c constraints.txt "torch_pmil[test] @ file://$$(realpath ../../dist/*.whl)"
	@cd build/dist && .venv/bin/python -m pytest -n 2 README.md docs/*/*.md notebooks tests --pyargs torch_pmil $(ARGS)

test-wheel: dist  ## the commands of the wheel alone and the README's Python, in an empty folder; PYTHON=python3.12 for another Python
	@rm -rf build/wheel && mkdir -p build/wheel
	@echo "Building build/wheel/.venv with the wheel; this takes a few minutes."
	@$(PYTHON) -m venv build/wheel/.venv
	@cd build/wheel && $(PIP) $(TORCH_ARGS) -c ../../constraints.txt torch==2.13.0
	@cd build/wheel && $(PIP) -c ../../constraints.txt "$$(echo ../../dist/*.whl)[gym]"
	@$(PYTHON) scripts/check_installed.py build/wheel/.venv/bin/pmil

clean:  ## remove what make and the tests built, not runs/
	@rm -rf .venv .mypy_cache .pytest_cache .ruff_cache docs/_build docs/api build dist *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: setup.cfg pyproject.toml constraints.txt
	@echo "Building .venv with $$($(PYTHON) --version); this takes a few minutes once."
	@$(PYTHON) -m venv .venv
	@$(PIP) $(TORCH_ARGS) -c constraints.txt torch==2.13.0
	@$(PIP) -c constraints.txt -e ".[test]"
	@.venv/bin/pmil compile
	@touch $@

.venv/.dev: .venv/.installed
	@$(PIP) -c constraints.txt -e ".[dev]"
	@touch $@

.venv/.docs: .venv/.installed
	@$(PIP) -c constraints.txt -e ".[docs]"
	@touch $@

.venv/.benchmark: .venv/.installed
	@$(PIP) -c constraints.txt -e ".[benchmark]"
	@touch $@
