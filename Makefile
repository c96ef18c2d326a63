# TalkingEyes. `make` lists what there is; everything sets itself up in .venv, with Python 3.11 and no root rights.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
TORCH := torch==2.13.0
corpus ?=
fit ?=
workspace ?= .
videos ?= ../shared/data/real/video
# The value of a variable for the shell, whatever characters are in it.
quoted = '$(subst ','\'',$(value $(1)))'

# One thread a process (work is parallel over processes), and no telemetry of any dependency.
export OMP_NUM_THREADS := 1
export MLFLOW_DISABLE_TELEMETRY := true
export DO_NOT_TRACK := true
export DVC_NO_ANALYTICS := 1
export RAY_USAGE_STATS_ENABLED := 0
export HF_HUB_DISABLE_TELEMETRY := 1
export PYTHONUNBUFFERED := 1
export PATH := $(abspath $(BIN)):$(PATH)
# setup compiles nothing beforehand, so Python has to keep what it compiles: DVC would compile 700 modules in every call.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup demo repro report params test check tiny sweep bench reliability wheel packaged-models release-models release-report face tables reference-ranges real-videos ui docs clean

help:  ## This list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(VENV)/.stamp  ## Install everything into .venv (done by the others when needed)

# torch alone first, then the lock, by its hashes and without looking at declared bounds (some are stale), then this package. Nothing is
# compiled beforehand: most modules are never imported, and it takes a minute.
$(VENV)/.stamp: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
		{ echo "error: Python 3.11 is needed, got $$($(PYTHON) --version 2>&1); say make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { echo "error: $(PYTHON) cannot make virtual environments; Debian has them in python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check $(TORCH)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# A model learns on one core, and DVC runs one stage after the other: two rows of stages run side by side (-s: what is
# before them is there). `dvc repro` alone gives the same; here it makes what is left, and says what failed. A row waits
# for the other's lock: DVC gives up after three seconds.
side_by_side = (export TALKINGEYES_PROGRESS=lines TALKINGEYES_JOBS=1; row='$(BIN)/dvc --wait-for-lock repro -s'; \
	$$row $(1) & one=$$!; $$row $(2); wait $$one)
# Rows of `make repro`: the paper's Table III and the default model. What else the report has is made by `make report`.
BASELINES = mean random similar untrained
REPRO = truth fitted mismatched $(BASELINES) vae talkingeyes_paper talkingeyes_events
REPRO_ONE = train@talkingeyes_events sample@talkingeyes_events $(BASELINES:%=train@%) $(BASELINES:%=sample@%)
REPRO_OTHER = critic pretrain@gaze_frames train@talkingeyes_paper sample@talkingeyes_paper train@vae sample@vae
REPRO_ONE_HALF = $(BASELINES:%=evaluate@%) evaluate@fitted
REPRO_OTHER_HALF = $(filter-out $(REPRO_ONE_HALF),$(REPRO:%=evaluate@%))
space := $(subst ,, )
# Those whose change makes it run again; another corpus has none that is synthesised.
REPRO_STAGES = $(if $(value corpus),,synthesize) fit embed $(REPRO_ONE) $(REPRO_OTHER) $(REPRO:%=evaluate@%)
row = $(foreach stage,train sample evaluate validate,$(stage)@$(1))
measured_model = $(call row,$(1)) information@$(1)
REPORT_ONE = pretrain@face $(filter-out validate@%,$(call row,probtalk3d)) $(call row,aligned_replay) $(call row,pieced_replay) \
	information@talkingeyes_events information@untrained $(REPRO:%=validate@%)
REPORT_OTHER = $(call measured_model,talkingeyes_live) pretrain@gaze_patches $(call measured_model,talkingeyes)

demo:  ## Animate the packaged recording with the packaged model; opens build/demo/index.html, three samples side by side
	@start=$$(date +%s); $(MAKE) --no-print-directory setup && \
	speech=$$($(BIN)/python -c 'from importlib.resources import files; print(files("moonshine_voice") / "assets/two_cities.wav")') && \
	rm -f build/demo/index.html && \
	$(BIN)/talkingeyes animate "$$speech" -o build/demo --samples 3 --no-previews --force && \
	$(BIN)/talkingeyes view build/demo/sample_0*.npz --sound "$$speech" --page build/demo/index.html --force && \
	echo "build/demo/index.html: three samples, made in $$(( $$(date +%s) - start )) s"
	@if [ "$$DISPLAY$$WAYLAND_DISPLAY" ]; then $(BIN)/python -m webbrowser build/demo/index.html; fi

repro: params  ## Make the corpus and the rows of Table III, in under 20 minutes. Another corpus: make repro corpus=DIR (fit=video if tracked)
	@if changed=$$($(BIN)/dvc status --json) && ! echo "$$changed" | grep -Eq '"($(subst $(space),|,$(strip $(REPRO_STAGES))))":'; \
	then log=; else log=--log; \
		$(BIN)/dvc repro fit embed && \
		{ $(call side_by_side,$(REPRO_ONE),$(REPRO_OTHER)); \
		$(call side_by_side,$(REPRO_ONE_HALF),$(REPRO_OTHER_HALF)); \
		$(BIN)/dvc repro $(REPRO:%=evaluate@%); } || exit $$?; \
	fi; $(BIN)/python -m pipelines.summary $$log $(REPRO)

report: repro  ## Then the other models, the face, what speech tells them, and data/report: 45 minutes more; goes on where it was killed
	@test -z "$$($(BIN)/dvc status -q || echo changed)" || { $(call side_by_side,$(REPORT_ONE),$(REPORT_OTHER)); $(BIN)/dvc repro; }
	@cat data/report/summary.txt

# Composing conf/ takes seconds, so it is done only if conf/, params.yaml or the choice of the corpus has changed.
CONF_STATE = cat $$(find conf -name '*.yaml' | sort) params.yaml | sha256sum; echo $(call quoted,corpus) $(call quoted,fit)

params: setup  ## Write params.yaml from conf/
	@test "$$($(CONF_STATE))" = "$$(cat $(VENV)/.params 2>/dev/null)" || { \
		$(BIN)/python -m pipelines.params $(if $(value corpus),corpus=$(call quoted,corpus)) $(if $(value fit),fit=$(call quoted,fit)) && \
		{ $(CONF_STATE); } > $(VENV)/.params; }

test: setup  ## Run the tests that take less than some five seconds each, with the tiny chain
	$(BIN)/python -m pytest -n 2 --maxfail 10 -m 'not long and not slow and not gpu and not browser'

check: setup  ## Format, lint, types, import order, then all tests that need no GPU, browser or other programs
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -n 2

tiny: setup  ## The whole chain on 24 clips in build/tiny, in under two minutes
	$(BIN)/python -m pipelines.experiment experiment=tiny

sweep: setup  ## A small search with two objectives in build/sweep, in under ten minutes; its front: build/sweep/smoke_test/pareto.png
	$(BIN)/python -m pipelines.experiment -m sweep=smoke_test

bench: setup  ## Measure speed and memory: benchmarks/*.py, each prints a table
	@failed=; for script in benchmarks/*.py; do name=$$(basename $$script .py); \
		echo "== $$name"; $(BIN)/python -m benchmarks.$$name || failed="$$failed $$name"; \
	done; if [ "$$failed" ]; then echo "failed:$$failed" >&2; exit 1; fi

mutations ?= 300
kills ?= 100
seed ?= 0
RELIABILITY = PYTHONPATH=.:tests:tests/helpers $(BIN)/python tests/reliability
reliability: setup  ## Damage files of every kind, and disturb commands at random moments: some hours, printed last is what failed
	$(RELIABILITY)/fuzz.py --mutations $(mutations) --seed $(seed) --keep build/reliability; failed=$$?; \
		$(RELIABILITY)/interruptions.py --kills $(kills) --seed $(seed) && exit $$failed

wheel: setup  ## Build dist/talkingeyes-*.whl, with the packaged models and the open head, and its SBOM
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist .
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes --upgrade --target build/cyclonedx -r docs/sbom.lock
	PYTHONPATH=build/cyclonedx $(BIN)/python -m cyclonedx_py environment --no-validate --output-reproducible --pyproject pyproject.toml \
		-o dist/talkingeyes.cdx.json $(BIN)/python
	@ls -l dist/talkingeyes-*.whl

packaged-models: models ?= data/train
packaged-models: setup  ## Put trained default models into the package: those of make report, or models=DIR
	$(BIN)/talkingeyes pack $(call quoted,models)/talkingeyes_events -o src/talkingeyes/animation/assets/talkingeyes_events.safetensors --half-precision --force
	$(BIN)/talkingeyes pack $(call quoted,models)/talkingeyes_live -o src/talkingeyes/animation/assets/talkingeyes_live.safetensors --no-face --half-precision --force

# Two models train at once, each in a workspace of its own, with one store of results.
RELEASE = $(BIN)/python -m pipelines.experiment experiment=release_models result_store=build/release/store
release-models: setup  ## Train the packaged models on 20 hours of seven languages; goes on where it was killed
	for target in fit embed; do $(RELEASE) target=$$target || exit $$?; done
	$(RELEASE) target=information@talkingeyes_live workspace=build/release/live & live=$$!; \
		$(RELEASE) target=information@talkingeyes_events; failed=$$?; wait $$live && exit $$failed
	for target in information@talkingeyes_live train@probtalk3d; do $(RELEASE) target=$$target || exit $$?; done
	$(RELEASE:release_models=release_remote_call) target=train@talkingeyes_events
	$(MAKE) --no-print-directory packaged-models models=build/release/data/train
	$(BIN)/talkingeyes pack build/release/remote_call/data/train/talkingeyes_events -o src/talkingeyes/animation/assets/talkingeyes_remote_call.safetensors --no-face --half-precision --force

release-report: setup  ## After make report: measure the packaged models on a sealed corpus; appends to docs/results/releases.md
	$(BIN)/python -m pipelines.results.release_report

face: setup  ## ProbTalk3D's Table 1: every model of the face, three seeds (docs/results/face_table.md has one so far); goes on where it was killed
	$(BIN)/python -m pipelines.results.face_table

tables: setup  ## TalkingEyes Tables III, V, VI and VII and their claims on three seeds (docs/results/tables.md); resumes. tables=table3,table7 seeds=0
	$(BIN)/python -m pipelines.results.tables $(if $(tables),tables=$(tables)) $(if $(seeds),seeds=$(seeds))

reference-ranges: setup  ## How eyes, head, lids and jaw of the corpus move, beside reference ranges of people. Another: corpus=DIR
	$(BIN)/python -m pipelines.results.reference_ranges $(if $(value corpus),$(call quoted,corpus))

real-videos: setup  ## Track and fit real videos and print the results. Your own: make real-videos videos=DIR
	$(BIN)/python -m pipelines.results.real_videos $(call quoted,videos)

ui: setup  ## Register the default model; compare runs in the browser, at 127.0.0.1:5000. make ui workspace=build/tiny
	@$(BIN)/python -m pipelines.register_model $(call quoted,workspace)
	@$(BIN)/python -m talkingeyes.orchestration.mlflow_view $(call quoted,workspace) 127.0.0.1:5000
	MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false $(BIN)/mlflow ui --host 127.0.0.1 --port 5000 \
		--backend-store-uri sqlite:///"$$(realpath -m $(call quoted,workspace))"/mlflow.db

docs: setup  ## Build the docs site: build/site/index.html
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --require-hashes -r docs/requirements.lock
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

clean:  ## Remove what runs left in build/ and the caches of tools; data/ and .venv stay
	rm -rf build .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
