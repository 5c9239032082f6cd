# Every target starts at `install`, which needs python3, make and git alone on a Debian-like system.
.DEFAULT_GOAL := help
SHELL := /bin/sh
PYTHON := $(if $(filter Windows_NT,$(OS)),.venv/Scripts/python.exe,.venv/bin/python)
UV := $(shell command -v uv 2>/dev/null || echo .uv/bin/uv)
# Root needs no sudo; everyone else is asked for it only where a package is missing.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
export UV_SYSTEM_CERTS := 1
export MPLBACKEND := agg
# Tests share the cores out among processes; threads of theirs would only wait for each other, busily.
test soak soak-identification soak-calibration fuzz oldest mutants: export OPENBLAS_NUM_THREADS := 1

## help: list the targets
.PHONY: help
help:
	@sed -n 's/^## /  make /p' Makefile

## install: uv, the locked environment in .venv, and the system packages of the window
.PHONY: install
install: .venv/.installed compiled system

.uv/bin/uv:
	@python3 -m venv .uv >/dev/null 2>&1 || { rm -rf .uv; $(SUDO) apt-get update -q && $(SUDO) apt-get install -y -q --no-install-recommends python3-venv && python3 -m venv .uv; }
	.uv/bin/python -m pip install --quiet --disable-pip-version-check uv

.venv/.installed: requirements.lock pyproject.toml | $(filter .uv/bin/uv,$(UV))
	[ -x $(PYTHON) ] || $(UV) venv --quiet --python '>=3.11,<3.13' .venv
	$(UV) pip sync --python $(PYTHON) --require-hashes --compile-bytecode requirements.lock
	$(UV) pip install --python $(PYTHON) --quiet --no-deps --no-build-isolation --editable .
	@touch $@

# Every start of the program would compile it anew where Python is told to leave no bytecode behind.
.PHONY: compiled
compiled: .venv/.installed
	@$(PYTHON) -m compileall -q src

# OpenGL for the answer window, PortAudio for noise, and a virtual display with its own keyboard for
# the tests and for machines without a screen.
DEBIAN_PACKAGES := libgl1 libgl1-mesa-dri libglx-mesa0 libglu1-mesa libx11-6 libxext6 libportaudio2 xvfb
.PHONY: system
system:
	@[ "$$(uname)" = Linux ] || exit 0; \
	libraries=$$(PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p); drivers=$$(ls /usr/lib/*/dri/swrast_dri.so /usr/lib/*/libgallium*.so 2>/dev/null || true); \
	case "$$libraries" in *libGLU.so.1*) glu=yes;; esac; case "$$libraries" in *libGL.so.1*) gl=yes;; esac; \
	case "$$libraries" in *libportaudio.so.2*) sound=yes;; esac; \
	[ -n "$$gl" ] && [ -n "$$glu" ] && [ -n "$$sound" ] && [ -n "$$drivers" ] && command -v Xvfb >/dev/null && exit 0; \
	command -v apt-get >/dev/null || { echo "Install OpenGL (libGL, libGLU, Mesa), PortAudio and Xvfb with this system's package manager, then run make again." >&2; exit 1; }; \
	$(SUDO) apt-get update -q && $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $(DEBIAN_PACKAGES)

## demo: a whole short session on the simulated rig, in the real window, then its report
.PHONY: demo
demo: install
	$(PYTHON) -m modaltouch demo

# Three processes keep two cores busy: windows, disks and watchdogs are waited for.
## test: the whole test suite, window tests included, on two cores
.PHONY: test
test: install
	$(PYTHON) -m pytest -n 3 --dist loadfile --no-loadscope-reorder

## check: formatting, lint, types and the import contracts
.PHONY: check
check: install
	$(PYTHON) -m ruff format --check src tests
	$(PYTHON) -m ruff check src tests
	$(PYTHON) -m mypy
	.venv/bin/lint-imports
	$(UV) pip check --python $(PYTHON)

## format: let ruff format and mend the code
.PHONY: format
format: install
	$(PYTHON) -m ruff format src tests
	$(PYTHON) -m ruff check --fix src tests

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
	cp build/identification/table_1.csv build/identification/fig_4.png build/identification/responses.png results/reference/
	$(PYTHON) -m modaltouch validate protocols/differentiated_stimulation.yaml --out build/validation
	cp build/validation/fig_[25678]*.png build/validation/fig_[25678]*.csv build/validation/validation.json results/reference/
	$(PYTHON) -m modaltouch compare protocols/differentiated_stimulation.yaml --out build/comparison
	cp build/comparison/comparison.csv results/reference/
	for name in fields price robustness drives; do cp build/comparison/$$name.png results/reference/comparison_$$name.png; done
	cp build/results/simulated/demo/derivatives/sub-demo_ses-1/screenshots/question_one_hand_AC.png results/reference/answer_window.png

## bench: run time against error, beside the peers, into results/benchmarks
.PHONY: bench
bench: install
	for script in tests/benchmarks/bench_*.py; do echo $$script; $(PYTHON) $$script || exit 1; done
	$(PYTHON) tests/benchmarks/bars.py

## soak: sessions cut short at 1,200 seeded points; what came of them goes into results/benchmarks/soak.json
.PHONY: soak
soak: install
	MODALTOUCH_KILL_POINTS=1200 MODALTOUCH_SOAK_RESULTS=results/benchmarks/soak.json \
	  $(PYTHON) -m pytest --timeout 7200 tests/sessions/test_durability.py

## accounted: a session of 240 trials in real time, its record against what the twin played
.PHONY: accounted
accounted: install
	$(PYTHON) tests/sessions/accounted.py --out results/benchmarks/accounted.json

## stops: 1,000 seeded deaths and dead links while bursts play; what came of them goes into results/benchmarks/stops.json
.PHONY: stops
stops: install
	$(PYTHON) tests/rig/stops.py --cases 1000 --out results/benchmarks/stops.json

## soak-identification: intervals judged by 200 seeds, and all nine modes through the whole driver, chirp and multisine
.PHONY: soak-identification
soak-identification: install
	MODALTOUCH_IDENTIFIED_SEEDS=200 MODALTOUCH_SCANNED_POINTS=41 \
	  $(PYTHON) -m pytest --timeout 3600 tests/identification/test_identify.py tests/identification/test_through_the_driver.py

## soak-calibration: forty beams calibrated through the whole driver, judged by the twin's true state
.PHONY: soak-calibration
soak-calibration: install
	MODALTOUCH_CALIBRATED_BEAMS=40 $(PYTHON) -m pytest --timeout 600 tests/calibration/test_through_the_driver.py

## fuzz: 20,000 spoilt files through every reader, and new examples for every property
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
	PYTHONPATH=src build/oldest/bin/python -m pytest -n 2 --dist loadfile -W ignore tests/adaptive tests/analysis tests/apparatus \
	  tests/observer tests/planning tests/preflight tests/protocol tests/record tests/schedule tests/stimulus

## mutants: spoil what others rest on, from stimulus to watchdog, one small mistake at a time; a test must notice each
.PHONY: mutants
mutants: install
	$(PYTHON) tests/mutation.py --out results/benchmarks/mutants.json

## schemas: write the JSON Schemas for editors again, after a change to what a file may hold
.PHONY: schemas
schemas: install
	$(PYTHON) -c "from pathlib import Path; from modaltouch.protocol.schemas import write_schemas; write_schemas(Path('protocols/schema'))"

## lock: resolve the dependencies again into requirements.lock
.PHONY: lock
lock: | $(filter .uv/bin/uv,$(UV))
	$(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	  --group dev pyproject.toml --upgrade --output-file requirements.lock

## clean: remove what was built, never results
.PHONY: clean
clean:
	rm -rf .venv .uv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
