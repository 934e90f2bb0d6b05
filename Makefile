# Every target sets up what it needs and is missing first; see tools/setup.sh.
PYTHON := .venv/bin/python

.PHONY: setup setup-demo demo test try-newest results warm-up lint format docs wheel release clean clean-caches

setup:
	@tools/setup.sh dev

setup-demo:
	@tools/setup.sh

demo: setup-demo
	$(PYTHON) diagrams/dynamic_grasp.py --scenario-name ReachCircular --controller task \
	  --object mustard_bottle --seed 1 --replay out/demo/replay.html --results out/demo/results.json
	@echo 'next: .venv/bin/feasigrasp run --help, or open out/demo/replay.html in a browser'

# One thread for linear algebra: quicker on small matrices, and timings can be compared.
test: export OMP_NUM_THREADS = 1
test: setup
	@$(MAKE) --no-print-directory --jobs 2 lint warm-up
	$(PYTHON) -m pytest -n auto --maxprocesses 4 --dist worksteal

# One run with the newest Python and Drake that can be had here.
try-newest: setup
	tools/try_newest.sh

# Every figure of README and docs anew, at one revision; resumable. By the estimates of its list 13 hours on two cores.
results: export OMP_NUM_THREADS = 1
results: setup
	$(PYTHON) -m feasigrasp.cli evaluate all --out out/results
	PYTHONPATH=. $(PYTHON) tools/figures.py store out/results

warm-up: setup
	$(PYTHON) -m feasigrasp.cli warm-up

lint: setup
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(PYTHON) -m mypy
	.venv/bin/lint-imports --no-logo
	$(PYTHON) tools/check_size.py

format: setup
	$(PYTHON) -m ruff check --fix
	$(PYTHON) -m ruff format

# The documentation as a site, in out/site; a warning is an error.
docs: export NO_MKDOCS_2_WARNING = 1
docs: setup
	PYTHONPATH=. $(PYTHON) -m mkdocs build --strict --quiet

wheel: setup
	$(PYTHON) -m build

# Wheel and sdist, each tried in an empty environment.
release: wheel
	tools/check_release.sh

clean:
	rm -rf out dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis

# `clean`, and what numba compiled: the next run compiles it again, for a minute or two.
clean-caches: clean
	find . -path ./.venv -prune -o -type d -name __pycache__ -exec rm -rf {} +
