# Two commands set everything up on a fresh machine with Python 3.11: `make demo` and `make test`.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin

.PHONY: demo test test-all check mutants faults faults-sitl faults-endurance faults-lines faults-interrupts faults-changes frozen sitl docs docs-site docs-figures notebooks clean
.DEFAULT_GOAL := demo

.venv/installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@

demo: .venv/installed  ## fly the paper's three maneuvers on the built-in vehicle, fit, report
	$(BIN)/flighttest run thrust roll_pitch yaw_rate --connect sim --yes

test: .venv/installed check  ## the checks and the default test suite, without its slow tests
	$(BIN)/python -m pytest -n auto --maxprocesses 8 --dist worksteal -m "not slow"

test-all: .venv/installed check  ## the checks and every test
	$(BIN)/python -m pytest -n auto --maxprocesses 8 --dist worksteal

check: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy examples/log_report.py
	$(BIN)/lint-imports

faults-changes: .venv/installed  ## a flight for each change of the flight's state that no fault of the table makes
	$(BIN)/python -m tests.faults.table --changes -o docs/faults.md

frozen: .venv/installed  ## diagnose the frozen bench of sealed flights and compare with the answers kept
	$(BIN)/python -m benchmarks.frozen

mutants: .venv/installed  ## loosen what decides, one change at a time, and see whether a test fails (an hour)
	$(BIN)/python -m tests.mutants

faults: .venv/installed  ## every fault of the link in every state of a flight, into docs/faults.md
	$(BIN)/python -m tests.faults.table -o docs/faults.md

faults-sitl: .venv/installed  ## the dangerous ones on a real ArduCopter (`arducopter` on PATH, or ARDUCOPTER)
	$(BIN)/python -m tests.faults.table --sitl -o docs/faults.md

faults-endurance: .venv/installed  ## an hour's flight in flat memory, and 20 flights of ten minutes with faults at random
	$(BIN)/python -m tests.faults.table --endurance -o docs/faults.md

faults-lines: .venv/installed  ## every shipped script over serial lines of 57600 and 115200 baud
	$(BIN)/python -m tests.faults.table --lines -o docs/faults.md

faults-interrupts: .venv/installed  ## how soon Ctrl-C is answered in each state of a flight, at a terminal
	$(BIN)/python -m tests.faults.table --interrupts -o docs/faults.md

docs: .venv/installed  ## write the generated parts of docs/
	$(BIN)/python docs/generate.py

docs-site:  ## the documentation as a web site that needs no network, in build/site
	test -x build/docs-venv/bin/mkdocs || { $(PYTHON) -m venv build/docs-venv && \
	build/docs-venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r docs/requirements.lock; }
	build/docs-venv/bin/mkdocs build --strict --quiet

docs-figures: .venv/installed  ## draw the figures of docs/terms.md, and measure those of docs/validity.md on recordings beside the checkout, again
	$(BIN)/python docs/term_figures.py
	$(BIN)/python docs/generate.py
	$(BIN)/python -m benchmarks.validity_recorded --write docs/validity.md

notebooks: .venv/installed  ## execute the notebooks in examples/ and write what they show
	$(BIN)/python docs/notebooks.py

sitl: .venv/installed  ## fly the demo on a real ArduPilot SITL
	$(BIN)/python sitl/launch.py --airframe paper --speedup 5 --fly thrust roll_pitch yaw_rate

clean:
	rm -rf .venv build dist *.egg-info
