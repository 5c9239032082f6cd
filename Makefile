# Every target starts at `install`, which needs python3, make and git alone on a Debian-like system.
.DEFAULT_GOAL := help
SHELL := /bin/sh
PYTHON := $(if $(filter Windows_NT,$(OS)),.venv/Scripts/python.exe,.venv/bin/python)
UV := $(shell command -v uv 2>/dev/null || echo .uv/bin/uv)
# Root needs no sudo; others need it only if a package is missing.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
# Installs the Debian packages in the shell variable `packages`, or says how to.
define INSTALL_PACKAGES
command -v apt-get >/dev/null || { echo "Install what holds these Debian packages on this system, then run make again: $$packages" >&2; exit 1; }; \
[ "$$(id -u)" = 0 ] || command -v sudo >/dev/null || { echo "This user may not install packages. As root: apt-get install $$packages" >&2; exit 1; }; \
$(SUDO) apt-get update -q && $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $$packages
endef
export UV_SYSTEM_CERTS := 1
export MPLBACKEND := agg
# Tests run in several processes; threads of BLAS would only compete with them.
test certify soak soak-identification soak-calibration spoilt fuzz oldest mutants: export OPENBLAS_NUM_THREADS := 1

## help: list the targets
.PHONY: help
help:
	@sed -n 's/^## /  make /p' Makefile

## install: uv, the locked environment in .venv, and the system packages of the window
.PHONY: install
install: .venv/.installed compiled system

.uv/bin/uv:
	@python3 -m venv .uv >/dev/null 2>&1 && exit 0; rm -rf .uv; packages=python3-venv; $(INSTALL_PACKAGES) && python3 -m venv .uv
	.uv/bin/python -m pip install --quiet --disable-pip-version-check uv

.venv/.installed: requirements.lock pyproject.toml | $(filter .uv/bin/uv,$(UV))
	[ -x $(PYTHON) ] || $(UV) venv --quiet --python '>=3.11,<3.13' .venv
	@echo 'Installing what requirements.lock names into .venv, which takes a minute or two the first time'
	@$(UV) pip sync --quiet --python $(PYTHON) --require-hashes --compile-bytecode requirements.lock
	$(UV) pip install --python $(PYTHON) --quiet --no-deps --no-build-isolation --editable .
	@touch $@

# Otherwise, where Python writes no bytecode, every start of the program would compile it.
.PHONY: compiled
compiled: .venv/.installed
	@$(PYTHON) -m compileall -q src

# Packages for the window, the masking noise and a virtual display, as listed by `doctor`.
.PHONY: system
system: compiled
	@[ "$$(uname)" = Linux ] || exit 0; \
	packages=$$($(PYTHON) -m modaltouch doctor --packages) || exit 1; [ -n "$$packages" ] || exit 0; \
	$(INSTALL_PACKAGES)

## demo: a whole short session on the simulated rig, in the real window, then its report
.PHONY: demo
demo: install
	$(PYTHON) -m modaltouch demo

# Five processes keep two cores busy, since tests wait for windows, disks and watchdogs. Compiled tests are kept:
# otherwise, where Python writes no bytecode, each process would compile all of them.
# Each process has one thread for linear algebra: more would wait for each other, and take twice as long.
## test: the whole test suite, window tests included, on two cores
.PHONY: test
test: export PYTHONDONTWRITEBYTECODE :=
test: export OPENBLAS_NUM_THREADS := 1
test: install
	$(PYTHON) -m pytest -n 5 --dist loadfile --no-loadscope-reorder

## check: formatting, lint, types, the import contracts, and no class name with two meanings
.PHONY: check
check: install
	$(PYTHON) -m ruff format --check src tests docs
	$(PYTHON) -m ruff check src tests docs
	$(PYTHON) -m mypy
	.venv/bin/lint-imports
	$(PYTHON) tests/names.py
	$(UV) pip check --python $(PYTHON)

## format: let ruff format and fix the code
.PHONY: format
format: install
	$(PYTHON) -m ruff format src tests docs
	$(PYTHON) -m ruff check --fix src tests docs

## results: the reference pictures in results/reference, from a simulated cohort, the demonstration and a scan of the twin
.PHONY: results
results: install
	rm -rf build/results build/analysis build/identification build/validation build/comparison
	$(PYTHON) -m modaltouch simulate protocols/differentiated_stimulation.yaml -n 10 --results build/results
	$(PYTHON) -m modaltouch analyse build/results --out build/analysis
	$(PYTHON) -m modaltouch demo --results build/results
	mkdir -p results/reference
	cp build/analysis/fig_10.csv build/analysis/fig_10.png build/analysis/fig_11.csv build/analysis/fig_11.png results/reference/
	$(PYTHON) -m modaltouch identify --out build/identification
	cp build/identification/table_1.csv results/reference/
	for name in fig_4 fits stability complexity; do cp build/identification/$$name.png results/reference/; done
	$(PYTHON) -m modaltouch validate protocols/differentiated_stimulation.yaml --out build/validation
	cp build/validation/fig_[25678]*.png build/validation/fig_[25678]*.csv build/validation/validation.json results/reference/
	$(PYTHON) -m modaltouch compare protocols/differentiated_stimulation.yaml --out build/comparison
	cp build/comparison/comparison.csv results/reference/
	for name in fields robustness; do cp build/comparison/$$name.png results/reference/comparison_$$name.png; done
	cp build/results/simulated/demo/derivatives/sub-demo_ses-1/screenshots/question_one_hand_AC.png results/reference/answer_window.png

## bench: run time against error, compared with other libraries; results in results/benchmarks
.PHONY: bench
bench: .venv/.bench
	for script in tests/benchmarks/bench_*.py; do echo $$script; $(PYTHON) $$script || exit 1; done
	$(PYTHON) tests/benchmarks/bars.py

## soak: sessions killed or interrupted at 1,200 seeded points; results in results/benchmarks/soak.json
.PHONY: soak
soak: install
	MODALTOUCH_KILL_POINTS=1200 MODALTOUCH_SOAK_RESULTS=results/benchmarks/soak.json \
	  $(PYTHON) -m pytest --timeout 7200 tests/session/test_durability.py

## accounted: compare the record of 240 trials in real time with what the twin played
.PHONY: accounted
accounted: install
	$(PYTHON) tests/session/accounted.py --out results/benchmarks/accounted.json

## stops: 1,000 seeded process deaths and dead links while bursts play; results in results/benchmarks/stops.json
.PHONY: stops
stops: install
	$(PYTHON) tests/rig/stops.py --cases 1000 --out results/benchmarks/stops.json

## doorstep: install clone and wheel in bare Debian 12 and 13, as root and as a user; DOORSTEP_PYTHON=FOLDER is a Python 3.11 or 3.12 for 13
.PHONY: doorstep
doorstep: install
	@command -v debootstrap >/dev/null || { packages=debootstrap; $(INSTALL_PACKAGES); }
	$(SUDO) python3 tests/doorstep.py $(if $(DOORSTEP_PYTHON),--python $(DOORSTEP_PYTHON)) --out results/benchmarks/doorstep.json

## stalls: twenty demonstrations with processes stopped and continued at seeded times; results in results/benchmarks/stalls.json
.PHONY: stalls
stalls: install
	$(PYTHON) tests/session/stalls.py --demos 20 --out results/benchmarks/stalls.json

## spoilt: 1,000 identifications and calibrations with one fault each: how many are marked or refused; results in results/benchmarks/spoilt.json
.PHONY: spoilt
spoilt: install
	$(PYTHON) tests/lab/spoilt.py --cases 1000 --out results/benchmarks/spoilt.json

## soak-identification: coverage of intervals over 200 seeds, and all nine modes through the whole driver, by chirp and multisine
.PHONY: soak-identification
soak-identification: install
	MODALTOUCH_IDENTIFIED_SEEDS=200 MODALTOUCH_SCANNED_POINTS=41 \
	  $(PYTHON) -m pytest --timeout 3600 tests/lab/identification/test_identify.py tests/lab/identification/test_through_the_driver.py

## soak-calibration: calibrate eighty beams, forty of them through the whole driver, and compare the intervals of 200 with the true state
.PHONY: soak-calibration
soak-calibration: install
	MODALTOUCH_CALIBRATED_BEAMS=40 MODALTOUCH_SEEDED_BEAMS=40 \
	  $(PYTHON) -m pytest --timeout 600 tests/lab/calibration/test_through_the_driver.py tests/lab/calibration/test_seeded_beams.py
	$(PYTHON) tests/lab/intervals.py --twins 200 --out results/benchmarks/intervals.json

## certify: error rate of each test and interval of the report in 210 populations; results in results/benchmarks; within half an hour on two cores
.PHONY: certify
certify: install
	$(PYTHON) tests/certify.py

## models-r: run models.R of every design in R, and compare p, intervals and estimates with R's; installs R by apt
.PHONY: models-r
models-r: install
	@command -v Rscript >/dev/null || { packages="r-base-core r-cran-lme4 r-cran-ordinal r-cran-coin r-cran-exactranktests"; $(INSTALL_PACKAGES); }
	$(PYTHON) tests/r/models.py

## bids: data sets of every shipped protocol and example through the BIDS validator, into results/benchmarks/bids.json
.PHONY: bids
bids: install build/bids/.installed
	$(PYTHON) tests/record/bids.py --validator build/bids/bin/bids-validator-deno --out results/benchmarks/bids.json

build/bids/.installed: tests/record/requirements.lock | $(filter .uv/bin/uv,$(UV))
	$(UV) venv --quiet --clear --python '>=3.11,<3.13' build/bids
	$(UV) pip sync --quiet --python build/bids/bin/python --require-hashes tests/record/requirements.lock
	@touch $@

## fuzz: 20,000 corrupted files through every reader, and new examples for every property test
.PHONY: fuzz
fuzz: install
	MODALTOUCH_MUTATIONS=20000 $(PYTHON) -m pytest --timeout 7200 tests/test_mutated_files.py
	for round in 1 2 3 4 5 6 7 8 9 10; do \
	  $(PYTHON) -m pytest -n 2 --dist loadfile --timeout 7200 -m hypothesis --hypothesis-profile search || exit 1; done

## oldest: the tests that need no window, with the oldest versions that pyproject.toml allows
.PHONY: oldest
oldest: | $(filter .uv/bin/uv,$(UV))
	mkdir -p build
	$(UV) pip compile --quiet --resolution lowest-direct --python-version 3.11 --group dev pyproject.toml -o build/oldest.txt
	$(UV) venv --quiet --clear --python 3.11 build/oldest
	$(UV) pip install --quiet --python build/oldest/bin/python -r build/oldest.txt
	PYTHONPATH=src build/oldest/bin/python -m pytest -n 2 --dist loadfile -W ignore tests/protocol tests/stimulus \
	  tests/preflight tests/record tests/analysis tests/planning

## mutants: make one small error at a time, from stimulus to watchdog; a test must notice each
.PHONY: mutants
mutants: install
	$(PYTHON) tests/mutation.py --out results/benchmarks/mutants.json

## schemas: write the JSON Schemas for editors again, after a change to the keys of a file
.PHONY: schemas
schemas: install
	$(PYTHON) -c "from pathlib import Path; from modaltouch.protocol.schemas import write_schemas; write_schemas(Path('protocols/schema'))"

## lock: resolve the dependencies again into requirements.lock and docs/requirements.lock
.PHONY: lock
lock: | $(filter .uv/bin/uv,$(UV))
	$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	  --group dev pyproject.toml --upgrade --output-file requirements.lock
	$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	  --constraints requirements.lock --group docs --upgrade --output-file docs/requirements.lock
	$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	  --constraints requirements.lock --group bench --upgrade --output-file tests/benchmarks/requirements.lock
	$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	  --group bids --upgrade --output-file tests/record/requirements.lock

## docs: the site, into build/docs; warnings and dead links inside it are errors
.PHONY: docs
docs: .venv/.docs
	@rm -rf build/docs
	@PYTHONPATH=src NUMEXPR_NUM_THREADS=1 $(PYTHON) -m sphinx --quiet --fail-on-warning --keep-going --fresh-env docs build/docs
	@echo 'Open build/docs/index.html'

## docs-check: build the site, run every command and snippet on it, and open it in a headless browser
.PHONY: docs-check
docs-check: docs
	@command -v chromium || command -v google-chrome || { packages=chromium; $(INSTALL_PACKAGES); }
	$(PYTHON) -m pytest --timeout 1800 tests/docs/check_pages.py tests/docs/check_typesetting.py

.venv/.bench: tests/benchmarks/requirements.lock .venv/.installed
	$(UV) pip install --python $(PYTHON) --quiet --require-hashes -r tests/benchmarks/requirements.lock
	@touch $@

.venv/.docs: docs/requirements.lock .venv/.installed
	$(UV) pip install --python $(PYTHON) --quiet --require-hashes -r docs/requirements.lock
	@touch $@

## clean: remove what was built, never results
.PHONY: clean
clean:
	rm -rf .venv .uv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
