# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
VENV ?= .venv
# The CPU build that the results were made with. For a GPU: `make demo TORCH=torch`
# (any release that pyproject.toml admits), or install your own torch into $(VENV) first.
TORCH ?= torch==2.13.0
BIN := $(VENV)/bin
JOBS ?= 2

.PHONY: demo test test-slow fuzz mutation check format bench structure policy loose-lid-policy docs constraints clean help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "skewmi needs Python 3.11 or newer; set PYTHON=..." >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || \
		{ echo "no venv module: apt-get install python3-venv" >&2; exit 2; }
	@$(BIN)/python -c 'import torch' 2>/dev/null || \
		{ echo "installing $(TORCH)"; $(BIN)/python -m pip install -q "$(TORCH)"; }
	@echo "installing skewmi and what it needs (a few minutes the first time)"
	@$(BIN)/python -m pip install -q -e '.[train,dev]'
	@touch $@

demo: $(VENV)/installed  ## deploy a policy on the simulated YuMi, film and replay it, train another
	$(BIN)/skewmi demo --overwrite

test: $(VENV)/installed  ## the whole suite but the slow tests
	$(BIN)/python -m pytest -q -n $(JOBS) -m "not slow"

test-slow: $(VENV)/installed  ## the tests marked slow
	$(BIN)/python -m pytest -q -n $(JOBS) -m slow

fuzz: $(VENV)/installed  ## a million adversarial planner cycles (half an hour)
	$(BIN)/python tests/adversarial/planner_fuzz.py --cycles 1000000 --processes $(JOBS) \
		--json --out results/planner_fuzz.json

mutation: $(VENV)/installed  ## does a test notice every weakened check? (minutes)
	@$(BIN)/python -c 'import cosmic_ray' 2>/dev/null || \
		$(BIN)/python -m pip install -q 'cosmic-ray>=8.7'
	$(BIN)/python tests/adversarial/mutation.py --json --out results/mutation.json

check: $(VENV)/installed  ## lint, formatting and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/installed  ## let ruff format and fix
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/installed  ## every benchmark of a few minutes; results/ gets the figures
	$(BIN)/python benchmarks/env.py --json --out results/env.json
	$(BIN)/python benchmarks/sac.py --json --out results/sac.json
	$(BIN)/python benchmarks/planner.py --json --out results/planner.json

structure: $(VENV)/installed  ## counts of how the project is built
	@$(BIN)/python benchmarks/structure.py

policy: $(VENV)/installed  ## train the bundled policy again (some 30 minutes) into runs/
	$(BIN)/skewmi train --task open_press_close --preset improved --run-dir runs/seed-0 --stop-on-convergence --resume
	$(BIN)/skewmi train --start-from runs/seed-0 --run-dir runs/robust --variation randomised --steps 660000
	$(BIN)/skewmi export-onnx runs/robust --out runs/open_press_close.onnx

LIDS := benchmarks/loose_lids
LOOSE := $(BIN)/skewmi train --resume --run-dir runs/loose
loose-lid-policy: $(VENV)/installed  ## train the one for lids that fall (an hour or more) into runs/
	$(LOOSE)-1 --task open_press_close --preset improved --option time_input=true --variation $(LIDS)/stage-1.yaml --steps 525000
	$(LOOSE)-2 --start-from runs/loose-1 --variation $(LIDS)/stage-2.yaml --steps 1140000
	$(LOOSE)-3 --start-from runs/loose-2 --variation $(LIDS)/stage-3.yaml --steps 1480000
	$(LOOSE)-4 --start-from runs/loose-3 --variation $(LIDS)/stage-4.yaml --steps 1795000
	$(LOOSE)-5 --start-from runs/loose-4 --variation $(LIDS)/stage-5.yaml --steps 2150000
	$(LOOSE)-6 --start-from runs/loose-5 --variation $(LIDS)/stage-6.yaml --steps 2500000
	$(BIN)/skewmi export-onnx runs/loose-6 --out runs/open_press_close_loose_lid.onnx

docs: $(VENV)/installed  ## the pages as a static site in build/site; a broken link fails
	@$(BIN)/python -c 'import mkdocstrings_handlers, material' 2>/dev/null || \
		$(BIN)/python -m pip install -q -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

constraints: $(VENV)/installed  ## exact versions of the deployment side into constraints/deploy.txt
	$(BIN)/python constraints/lock.py

clean:
	rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
