# Each target does all of its own set-up: it needs python3 (3.11 or later, with venv), make and git, and nothing else.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
TESTABLE := $(VENV)/testable

.PHONY: fly test test-fast test-mujoco3 docs bench fidelity pictures paper validation physics format clean

fly: $(INSTALLED)  ## fly the default flock on MuJoCo physics
	$(BIN)/moflock fly

test: $(TESTABLE)  ## lint, types, import rule, tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n auto -q

test-fast: $(TESTABLE)  ## the tests that need no real program and no long flight
	$(BIN)/pytest -n auto -q -m "not slow"

test-mujoco3: $(TESTABLE)  ## the tests of the bodies on the older major version of MuJoCo
	$(BIN)/python -m pip install --quiet --no-deps --upgrade --target $(VENV)/mujoco3 mujoco==3.17.0
	PYTHONPATH=$(VENV)/mujoco3 $(BIN)/pytest -n auto -q tests/moflock_mj/dynamics tests/controllers/flight_control

docs: $(TESTABLE)  ## the documentation as a site: site/index.html; refuses broken links
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

bench: $(TESTABLE)  ## timings, on one core
	$(BIN)/python -m tests.benchmarks

fidelity: $(TESTABLE)  ## agreement with RobotSim and with the paper
	$(BIN)/python -m tests.fidelity.robotsim

pictures: $(TESTABLE)  ## the README's pictures; needs Chromium
	$(BIN)/python docs/make_pictures.py

paper: $(INSTALLED)  ## the paper's numbers and figures, ours beside them: docs/reproduction.md
	$(BIN)/python -m optimize.studies.paper

validation: $(INSTALLED)  ## named points on rigid bodies, and the airframe's point mass: docs/validation.md
	$(BIN)/python -m optimize.studies.validation

physics: $(INSTALLED)  ## searches on rigid bodies beside the front of `make paper`: docs/physics.md
	$(BIN)/python -m optimize.studies.physics

format: $(TESTABLE)  ## format the sources
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove what was built; flights in logs/ stay
	rm -rf $(VENV) dist site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade --constraint constraints.txt pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(TESTABLE): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --group dev --editable '.[all]'
	touch $@
