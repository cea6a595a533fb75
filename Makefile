# Every target makes its own Python environment first (tools/bootstrap.sh): nothing has to be installed beforehand.
BIN := .venv/bin
# Without the compiled files of our own sources and tests, each of their many processes would compile them again.
unexport PYTHONDONTWRITEBYTECODE
.DEFAULT_GOAL := help
.PHONY: help env demo docs test lint test-slow test-grounded-sam strength bench wheels clean

help: ## show this list
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

env: ## create the Python environment in .venv, and nothing else
	@sh tools/bootstrap.sh

demo: env ## run three tasks of the exam once and write an HTML report into runs/demo
	@$(BIN)/carecontact run --demo

test: env lint ## check style, types, import rules and run the fast tests
	$(BIN)/python -m pytest -n auto --dist worksteal

lint: env ## check style, types and import rules only
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

test-slow: env ## run the long simulations, Ray among them (the extra cluster, 200 MB)
	.venv-uv/bin/uv sync --frozen --inexact --quiet --extra cluster --python $(BIN)/python
	$(BIN)/python -m pytest -m slow

test-grounded-sam: env ## test the segmenter on tiny random models, in .venv-torch (5 GB)
	UV_PROJECT_ENVIRONMENT=.venv-torch .venv-uv/bin/uv sync --frozen --quiet --extra grounded-sam --python $(BIN)/python
	.venv-torch/bin/python -m pytest -m torch tests/sensing/test_grounded_sam.py

strength: env ## plant known faults in copies of the tree and count those that the tests see (an hour on 2 cores)
	$(BIN)/python tools/strength.py --jobs 2

bench: env ## measure the speed of physics, trials and command line, as JSON
	@$(BIN)/python benchmarks/speed.py

wheels: env ## build the sdist and the wheels of every platform into dist, and try them in new environments
	@.venv-uv/bin/uv run --quiet --isolated --no-project --python $(BIN)/python --with lief==1.0.0 \
		--with mujoco-core==4.0.0 --with twine==7.0.0 python tools/wheels.py .venv-uv/bin/uv

docs: env ## build the website of the documentation into build/site
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

clean: ## remove what the other targets made, runs/demo included
	rm -rf .venv .venv-uv .venv-torch build dist runs/demo .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	rm -f src/carecontact/tissue/libcarecontact_kernel.*
	find src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
