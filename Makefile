PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo demo-files docs test test-slow test-grblhal test-bounds coverage hooks fuzz fuzz-wire bench results release clean

setup: .venv/.ready

.venv/.ready: pyproject.toml .ci/setup
	PYTHON=$(PYTHON) sh .ci/setup
	touch $@ .venv/.runs

.venv/.runs: pyproject.toml .ci/setup
	PYTHON=$(PYTHON) sh .ci/setup rig
	touch $@

demo demo-files: export PYTHONDONTWRITEBYTECODE =  # empty is unset: the first of many commands writes what all others import
demo: .venv/.runs
	sh .ci/demo

demo-files: .venv/.runs
	sh .ci/demo-files

docs: .venv/.runs
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[docs]'
	$(BIN)/python -m docs.make.rig_toml > docs/rig-toml.md
	$(BIN)/python -m docs.make.tables > docs/tables.md
	$(BIN)/python -m docs.make.commands > docs/commands.md
	$(BIN)/python -m docs.make.validation > docs/validation.md
	$(BIN)/rig effects document --force --out docs/effects.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

test: export PYTHONDONTWRITEBYTECODE =  # as above, for the processes that tests start
test: setup
	$(BIN)/python -m tests.compile_kernels
	$(BIN)/python -m pytest -q -n auto --dist worksteal

test-slow: setup
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[bucket]'
	$(BIN)/python -m pytest -q -m slow

out/grblhal/play/grblHAL_sim: | setup
	sh .ci/grblhal-simulator

test-grblhal: out/grblhal/play/grblHAL_sim
	GRBLHAL_PLAIN_SIMULATOR=$(CURDIR)/out/grblhal/plain/grblHAL_sim $(BIN)/python -m pytest -q -m slow tests/rig/driving/protocols/test_grblhal_simulator.py
	GRBLHAL_SIMULATOR=$(CURDIR)/out/grblhal/rigkins/grblHAL_sim GRBLHAL_CALIBRATION=$(CURDIR)/out/grblhal/calibration.json $(BIN)/python -m pytest -q -m slow tests/calib/correction/test_grblhal_run.py
	GRBLHAL_SIMULATOR=$(CURDIR)/out/grblhal/play/grblHAL_sim GRBLHAL_CALIBRATION=$(CURDIR)/out/grblhal/play.json $(BIN)/python -m pytest -q -m slow tests/calib/correction/test_grblhal_run.py

coverage: setup
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[coverage]'
	$(BIN)/python -m pytest -q -n auto --cov --cov-report= --cov-report=html:out/coverage --cov-report=json:out/coverage.json $(TESTS)
	$(BIN)/python -m tests.coverage_by_folder out/coverage.json

hooks: setup
	$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[hooks]'
	$(BIN)/python -m pre_commit install

fuzz: setup
	$(BIN)/python -m pip install -q atheris
	$(BIN)/python -m tests.fuzz.campaign 1000000 out/fuzz

fuzz-wire: setup
	$(BIN)/python -m pip install -q atheris
	for parser in grblhal gcs linuxcnc struts requests; do $(BIN)/python -m tests.rig.coverage_guided_fuzzing $$parser 1000000 || exit 1; done

test-bounds: setup
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=out/numba-bounds $(BIN)/python -m pytest -q -p no:cacheprovider -n auto tests/calib tests/vision tests/rig

bench: setup
	$(BIN)/python -m tests.bench

results: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.bench.results $(BENCH)

release: setup
	sh .ci/release

clean:
	rm -rf .venv out dist build
