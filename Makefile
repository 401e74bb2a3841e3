# Run `make` for the list of targets. Everything runs in .venv, which is made when it is missing;
# `make VENV=.venv-jazzy ...` does the same with the libraries of Ubuntu 24.04.

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin

# A ROS 2 installation sourced in the calling shell must not mix with the one in .venv.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME PYTHONPATH
unexport RMW_IMPLEMENTATION VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Without cached bytecode a node takes twice as long to start.
unexport PYTHONDONTWRITEBYTECODE

# ROS 2 stays on this machine unless told otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# One thread each: the matrices are small, and figures do not depend on the number of cores.
export OPENBLAS_NUM_THREADS ?= 1

# Through the environment, so that brackets, ^, spaces and quotes reach the command as typed.
export PROCESS

# Folders that need not be read where no tests over ROS 2, or only such, are asked for.
OVER_ROS := docs examples reliability ros
WITHOUT_ROS := core fuzzing plants reliability workspace
# Processes that run tests: two per core, since those over ROS 2 mostly wait; of the slow ones without it one per core.
WORKERS := $(shell echo $$((2 * $$(nproc))))
# PATIENCE=2 in the environment doubles what tests wait for.
PYTEST = "$(BIN)/python" -m pytest -p tests.patience --numprocesses $(WORKERS) --dist loadfile

# The share of the work that is done: of each test's cases, of the tests that take long, and of campaigns.
SHARE := 1
# Which part that is: each commit has the next.
export TURN ?= $(shell git rev-list --count HEAD 2>/dev/null || echo 0)
# `make reliability`: where its figures go, and how many loops run side by side.
PAGE := docs/reliability.md
LOOPS_AT_ONCE := 4

.PHONY: help
help: ## Show this list
	@awk 'BEGIN { FS = ":.*## " } /^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

.PHONY: venv
venv: ## Make .venv, or bring it up to date
	@tools/make_venv.sh $(VENV)

.PHONY: demo
demo: venv ## Tune and run a loop over ROS 2, write the report [PROCESS='9/((s+1)(s^2+2s+9))']
	@"$(BIN)/fopid_demo" "--process=$${PROCESS:-P1}" $(ARGS)

.PHONY: test
test: venv ## Run the fast tests, of each three cases, others at each commit; all cases of what ARGS='-k name' picks
	@SHARE=$(SHARE) MOST_CASES=$(if $(ARGS),,3) $(PYTEST) $(ARGS)

.PHONY: test-slow
test-slow: venv ## Run the tests marked slow [ARGS='-k name' SHARE=0.1]
	@export SHARE=$(SHARE); core=0; $(PYTEST) --timeout 900 --numprocesses auto --dist worksteal \
	  --ignore src $(OVER_ROS:%=--ignore tests/%) \
	  -m 'slow and not (ros or colcon or reliability)' $(ARGS) || core=$$?; \
	ros=0; $(PYTEST) --timeout 900 --ignore src $(WITHOUT_ROS:%=--ignore tests/%) \
	  -m 'slow and ros and not (colcon or reliability)' $(ARGS) || ros=$$?; \
	[[ "$$core $$ros" =~ ^(0 [05]|5 0)$$ ]]  # 5: none of them was asked for

.PHONY: test-all
test-all: venv ## Run the fast and the slow tests
	@$(PYTEST) -m 'not colcon and not reliability' $(ARGS)

.PHONY: test-again
test-again: venv ## Run once more those of the fast and slow tests that have failed
	@SHARE=$(SHARE) $(PYTEST) --timeout 900 -m 'slow or not slow' --last-failed --last-failed-no-failures none $(ARGS)

.PHONY: test-jazzy
test-jazzy: ## Fast tests, every verb and the demonstration with the libraries of Ubuntu 24.04 [SHARE=0.2]
	@$(MAKE) VENV=.venv-jazzy test
	@$(MAKE) VENV=.venv-jazzy test-verbs
	@$(MAKE) VENV=.venv-jazzy demo

.PHONY: test-verbs
test-verbs: venv ## Run each verb of the command line once
	@SHARE=1 $(PYTEST) -m 'slow or not slow' tests/core/cli/test_verbs.py tests/core/study/reproduce/test_reproduction.py $(ARGS)

.PHONY: coverage
coverage: venv ## Branches that the fast tests and the slow ones of verbs, studies and nodes take [ARGS=tests/core]
	@export COVERAGE_FOLDER="$(CURDIR)/build/coverage" PATIENCE=4; \
	rm -rf "$$COVERAGE_FOLDER"; \
	run=($(subst -m pytest,-m coverage run -m pytest,$(PYTEST))); \
	failed=0; "$${run[@]}" $(ARGS) || failed=1; \
	if [[ -z "$(ARGS)" ]]; then \
	  "$${run[@]}" -m 'slow and not colcon' tests/core/{cli,study} tests/ros/{tuner,dashboard,experiment} || failed=1; \
	fi; \
	"$(BIN)/python" -m coverage combine --quiet; \
	report=("$(BIN)/python" -m coverage report); \
	if [[ -n "$(ARGS)" ]]; then "$${report[@]}"; exit "$$failed"; fi; \
	"$${report[@]}" --include='src/fopid_core/*' --fail-under=95 || failed=1; \
	"$${report[@]}" --include='src/fopid_ros/*' --fail-under=90 || failed=1; \
	exit "$$failed"  # a test that failed hides no figure

.PHONY: fuzz
fuzz: venv ## Hand every reader many odd cases, guided by coverage [CASES=100000] [TARGETS=csv]
	@"$(BIN)/uv" pip install --quiet --python "$(BIN)/python" atheris==3.0.0; \
	for target in $(or $(TARGETS),text line experiment csv bag message parameters request explore asked http); do \
	  nice -n 19 "$(BIN)/python" -m tests.fuzzing.campaign $$target --cases $(or $(CASES),1000) 2>build/fuzz.log; \
	done

.PHONY: bench
bench: venv ## Measure the performance figures, each beside its baseline, into docs/performance.md
	@mkdir -p build
	@"$(BIN)/fopid" benchmark --json >build/benchmark_core.json
	@"$(BIN)/fopid_ros_benchmark" --json >build/benchmark_ros.json
	@"$(BIN)/python" -m tests.hand_to_picture >build/benchmark_browser.json
	@"$(BIN)/python" tools/performance_table.py build/benchmark_{core,ros,browser}.json docs/performance.md

.PHONY: simulators
simulators: venv ## Add the simulators of others that some foreign plants run in: MuJoCo, gym-electric-motor, do-mpc
	@"$(BIN)/uv" pip install --quiet --python "$(BIN)/python" --no-deps -r requirements-plants.txt || \
	"$(BIN)/python" -m pip install -qq --disable-pip-version-check --no-deps -r requirements-plants.txt

.PHONY: plants
plants: simulators ## Compare start gains, rules, autotuning and the best known on foreign plants, into docs/plants.md [ARGS=crane]
	@"$(BIN)/python" examples/plants/compare.py $(if $(ARGS),$(ARGS),--out docs/plants.md)

.PHONY: docs
docs: venv ## Build the documentation, into build/docs
	@"$(BIN)/sphinx-build" --fail-on-warning --keep-going --quiet -d build/doctrees docs build/docs
	@echo build/docs/index.html

.PHONY: verdict
verdict: venv ## PI, PID, FOPI and FOPID on a thousand processes, into docs/verdict.md: hours; goes on where it was left
	@"$(BIN)/fopid" campaign config/campaigns/verdict.yaml
	@"$(BIN)/python" tools/verdict_page.py runs/verdict.parquet docs/verdict.md $(ARGS)

.PHONY: reliability
reliability: venv ## Attack the running loop, write the figures into docs/reliability.md [SHARE=0.1 PAGE=copy.md]
	@rm -rf build/reliability
	@SHARE=$(SHARE) "$(BIN)/python" -m pytest --numprocesses $(LOOPS_AT_ONCE) -m reliability tests/reliability $(ARGS)
	@[ "$(PAGE)" = docs/reliability.md ] || cp docs/reliability.md "$(PAGE)"
	@"$(BIN)/python" tools/reliability_page.py build/reliability "$(PAGE)"

.PHONY: lint
lint: venv ## Check format, style, types and who imports whom
	@"$(BIN)/ruff" format --check
	@"$(BIN)/ruff" check
	@"$(BIN)/mypy"
	@"$(BIN)/lint-imports" --no-cache

.PHONY: format
format: venv ## Format the sources and mend what can be mended
	@"$(BIN)/ruff" check --fix-only --quiet
	@"$(BIN)/ruff" format

.PHONY: colcon
colcon: venv ## Build and test the tree as a colcon workspace, in build/colcon
	@tools/colcon_build.sh

.PHONY: release
release: venv ## Build and try wheels and sdists in clean environments [PYTHONS="3.11 3.12 3.13"]
	@PYTHONS='$(PYTHONS)' tools/release.sh

.PHONY: lock
lock: venv ## Compile requirements*.in anew [ARGS='--upgrade']
	@export UV_CUSTOM_COMPILE_COMMAND='make lock'; \
	lock=("$(BIN)/uv" pip compile --quiet --no-emit-index-url --override requirements-override.in $(ARGS)); \
	"$${lock[@]}" --python-version 3.11 requirements-dev.in --output-file requirements-dev.txt; \
	"$${lock[@]}" --python-version 3.11 --constraint requirements-dev.txt requirements.in --output-file requirements.txt; \
	"$${lock[@]}" --python-version 3.11 --constraint requirements-dev.txt requirements-plants.in \
	  --output-file requirements-plants.txt; \
	"$${lock[@]}" --python-version 3.12 requirements-jazzy.in --output-file requirements-jazzy.txt

.PHONY: clean
clean: ## Remove everything make made, .venv too
	rm -rf .venv .venv-jazzy build .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find src tests tools -name __pycache__ -prune -exec rm -rf {} +
	rm -rf src/*/*.egg-info
