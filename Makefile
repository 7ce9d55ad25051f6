# Two entry points for a newcomer: `make demo` and `make test`. Everything else builds on the same environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
# what one process has compiled serves the others: the tests start many
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all check lint bench bench-estimation bench-world bench-vehicles bench-api bench-page bench-fleet bench-rivals mutants chaos house clean bench-adhesion bench-rails bench-signatures bench-dampers bench-steps bench-limits bench-trend

$(VENV)/.runtime: pyproject.toml constraints.txt
	@echo "building the virtual environment in $(VENV) (about two minutes)"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --constraint constraints.txt --editable .
	@$(BIN)/treadwatch demo --once --scenario mems --folder $(VENV)/compiling > /dev/null # numba keeps what it compiles
	@rm -r $(VENV)/compiling
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	@echo "installing the test tools"
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

demo: $(VENV)/.runtime
	@$(BIN)/treadwatch demo $(ARGS)

PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist worksteal

test: $(VENV)/.dev # what a change needs
	$(PYTEST) --ignore tests/texts -m "not slow" $(ARGS)

test-all: test # and what simulates, starts processes or kills them for long
	$(PYTEST) --ignore tests/texts -m slow $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest --quiet tests/texts

check: lint test-all

bench-estimation: $(VENV)/.dev
	$(BIN)/python -m bench section $(ARGS)

bench-world: $(VENV)/.dev
	$(BIN)/python -m bench world $(ARGS)

bench-signatures: $(VENV)/.dev
	$(BIN)/python -m bench signatures $(ARGS)

bench-vehicles: $(VENV)/.dev
	$(BIN)/python -m bench vehicles $(ARGS)

bench-api: $(VENV)/.dev
	$(BIN)/python -m bench api $(ARGS)

bench-page: $(VENV)/.dev
	$(BIN)/python -m bench page $(ARGS)

bench-fleet: $(VENV)/.dev
	$(BIN)/python -m bench fleet $(ARGS)

bench-rivals: $(VENV)/.dev
	$(BIN)/python -m bench rivals $(ARGS)

bench-adhesion: $(VENV)/.dev
	$(BIN)/python -m bench adhesion $(ARGS)

bench-rails: $(VENV)/.dev
	$(BIN)/python -m bench rails $(ARGS)

bench-dampers: $(VENV)/.dev
	$(BIN)/python -m bench dampers $(ARGS)

bench-steps: $(VENV)/.dev
	$(BIN)/python -m bench steps $(ARGS)

bench-trend: $(VENV)/.dev
	$(BIN)/python -m bench trend $(ARGS)

bench-limits: $(VENV)/.dev
	$(BIN)/python -m bench limits $(ARGS)

bench: $(VENV)/.dev
	$(BIN)/python -m bench $(ARGS)

mutants: $(VENV)/.dev
	$(BIN)/python -m bench mutants $(ARGS)

chaos: $(VENV)/.dev
	$(BIN)/python -m bench chaos $(ARGS)

house: $(VENV)/.dev
	$(BIN)/python -m bench house $(ARGS)

clean:
	rm -rf $(VENV) build *.egg-info treadwatch-data
