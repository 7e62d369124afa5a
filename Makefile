# make run: set up a fresh machine and calibrate the built-in scene. make test: the same set-up, then the tests.
VENV ?= .venv
PYTHON ?= python3
JOBS ?= 2
CASES ?= 20000
SEED ?= 0
BENCH ?=
SOURCES := $(shell find toolkit plugins baselines -type f -not -path '*/__pycache__/*' -not -path '*.egg-info/*') pyproject.toml README.md

.PHONY: run test test-system fuzz bench dev lint docs clean

# PyTorch of the default index brings CUDA on Linux; where disk is short: make PIP_ARGS="--extra-index-url CPU_INDEX"
$(VENV)/.locked: requirements.lock
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check $(PIP_ARGS) torch==2.13.0
	touch $@

# The wheel is what is run and tested, not the source tree.
$(VENV)/.installed: $(VENV)/.locked $(SOURCES)
	rm -rf build/wheel && $(VENV)/bin/python -m build -q --no-isolation --wheel --outdir build/wheel
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check --no-deps --force-reinstall build/wheel/*.whl
	touch $@

# Weights for research only, which some tests and suites need; `make run` does not.
$(VENV)/.research: $(VENV)/.installed plugins/kitti_weights/pyproject.toml
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation ./plugins/kitti_weights
	touch $@

run: $(VENV)/.installed
	$(VENV)/bin/p2o run --out p2o-out

# One thread per process: BLAS and PyTorch threads of several processes would wait for each other. Tests of one file stay
# in one process, which shares their fixtures; idle processes take over tests of others.
test: $(VENV)/.research
	OMP_NUM_THREADS=1 P2O_STRICT=1 $(VENV)/bin/python -m pytest -q -n $(JOBS) --dist worksteal --durations=40 -m "not system"

# Fuzzing, killed processes, browsers, the lines of the docs, distributions and long studies.
test-system: $(VENV)/.research
	OMP_NUM_THREADS=1 P2O_STRICT=1 $(VENV)/bin/python -m pytest -q -n $(JOBS) --dist worksteal -m system

# Mutated inputs at every door (docs/reliability.md): make fuzz CASES=20000 SEED=0
fuzz: $(VENV)/.research
	$(VENV)/bin/python -m tests.fuzz --cases $(CASES) --seed $(SEED) --jobs $(JOBS)

# What each step costs, also of another commit in turns (docs/performance.md): make bench BENCH="--against-commit REV"
bench: $(VENV)/.locked
	$(VENV)/bin/python benchmarks/bench.py $(BENCH)

lint: $(VENV)/.locked
	$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check . && $(VENV)/bin/mypy

# The site of docs/, with strict links, in build/site.
docs: $(VENV)/.research
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --strict -q

dev: $(VENV)/.locked
	$(VENV)/bin/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e . -e ./plugins/kitti_weights
	rm -f $(VENV)/.installed

clean:
	rm -rf $(VENV) build/wheel p2o-out
