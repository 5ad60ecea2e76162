# Each target does all of its own set-up: it needs python3 (3.11 or later, with venv), make and git, and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready

.PHONY: fly test bench fidelity format clean

fly: $(READY)  ## fly the default flock on MuJoCo physics
	$(BIN)/moflock fly

test: $(READY)  ## lint, types, import rule, tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n auto -q

bench: $(READY)  ## timings, on one core
	$(BIN)/python -m tests.benchmarks

fidelity: $(READY)  ## agreement with RobotSim and with the paper
	$(BIN)/python -m tests.fidelity.robotsim

format: $(READY)  ## format the sources
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove what was built; flights in logs/ stay
	rm -rf $(VENV) dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade --constraint constraints.txt pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --group dev --editable .
	touch $@
