# `make demo` and `make test` set up whatever is missing first; see tools/setup.sh.
PYTHON := .venv/bin/python

.PHONY: setup demo test lint format wheel clean

setup:
	@tools/setup.sh

demo: setup
	$(PYTHON) diagrams/dynamic_grasp.py --scenario_name ReachCircular --controller task \
	  --object mustard_bottle --seed 1 --replay out/demo/replay.html --results out/demo/results.json

# One thread for linear algebra: quicker on small matrices, and timings can be compared.
test: export OMP_NUM_THREADS = 1
test: lint
	$(PYTHON) -m pytest

lint: setup
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy

format: setup
	$(PYTHON) -m ruff check --fix
	$(PYTHON) -m ruff format

wheel: setup
	$(PYTHON) -m build

clean:
	rm -rf out dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -path ./.venv -prune -o -type d -name __pycache__ -exec rm -rf {} +
