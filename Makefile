PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo demo-files test test-slow bench clean

setup: .venv/.ready

.venv/.ready: pyproject.toml .ci/setup
	PYTHON=$(PYTHON) sh .ci/setup
	touch $@

demo: setup
	sh .ci/demo

demo-files: setup
	sh .ci/demo-files

test: setup
	$(BIN)/python -m pytest -q -n auto

test-slow: setup
	$(BIN)/python -m pytest -q -m slow

bench: setup
	$(BIN)/python -m tests.bench

clean:
	rm -rf .venv out
