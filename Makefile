# Everything runs in a virtual environment of its own; nothing is needed but Python >= 3.11.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# the viewer's analytics stay off
export CI ?= 1
# into the environment of a Python: by uv, where it can be had, in a tenth of the time
install = $(BIN)/uv pip install --quiet --python $(1) $(2) || \
  { $(1) -m pip install --quiet --upgrade pip && $(1) -m pip install --quiet $(2); }
# the systems that types are checked for
SYSTEMS := linux win32 darwin

.PHONY: demo dev fmt check style $(SYSTEMS:%=types-%) compile test sweeps golden build wheel bench fuzz big accept excerpts proto docs pictures clean

demo: $(VENV)/installed ## set up, then replay and score the bundled walk, and show it
	$(BIN)/groundtrace demo

$(VENV)/pip:
	$(PYTHON) -m venv $(VENV)
	-$(BIN)/pip install --quiet --only-binary :all: uv
	touch $@

$(VENV)/installed: $(VENV)/pip pyproject.toml
	$(call install,$(BIN)/python,--editable .)
	touch $@

dev: $(VENV)/dev ## all that tests and checks need

$(VENV)/dev: $(VENV)/pip pyproject.toml
	$(call install,$(BIN)/python,--editable ".[seismic]" --group dev)
	touch $@ $(VENV)/installed

fmt: dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

check: style $(SYSTEMS:%=types-%) audit ## types as each of the systems has them

style: dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-cache

$(SYSTEMS:%=types-%): types-%: dev ## each by itself, so that they can run at the same time
	$(BIN)/mypy --platform $* --cache-dir .mypy_cache/$*

ADVISORIES := api.osv.dev
audit: dev ## the dependencies that are installed, against known faults, where these can be asked for
	@mkdir -p build; $(BIN)/pip freeze --quiet --exclude-editable > build/installed.txt
	@if $(BIN)/python -c "import socket; socket.create_connection(('$(ADVISORIES)', 443), 5)" 2>/dev/null; then \
	  $(PYTHON) -m venv build/audit && build/audit/bin/pip install --quiet pip-audit && \
	  build/audit/bin/pip-audit --vulnerability-service osv --timeout 15 --progress-spinner off \
	    --no-deps --disable-pip --requirement build/installed.txt; \
	else echo "audit: $(ADVISORIES) cannot be reached: the dependencies were not audited"; fi

compile: dev ## all kernels, once, before those who would compile them at the same time
	$(BIN)/python -c "from groundtrace import kernels; [getattr(kernels, name) for name in kernels.__all__]"

# half as many tests again as there are cores: many wait for a process or a browser
WORKERS = $(shell $(PYTHON) -c "import os; print(max(1, (os.cpu_count() or 1) * 3 // 2))")

test: dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal
	NUMBA_DISABLE_JIT=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto tests/oracles # as plain Python

sweeps: dev ## tests and cases beside those of every day, and all examples that are drawn
	GROUNDTRACE_SWEEPS=1 OMP_NUM_THREADS=1 \
	  $(BIN)/python -m pytest -n auto --dist worksteal -m "sweep or hypothesis"

# versions to try, and the tests that depend on the version most: files, commands, all pipelines
PYTHONS := 3.11 3.12 3.13
QUICK := tests/codecs tests/cli/test_command_line.py tests/cli/test_import.py tests/cli/test_json.py \
  tests/test_*.py

pythons: ## the quick tests on each version of Python that is here as pythonX.Y
	@for version in $(PYTHONS); do \
	  if ! python$$version -V >/dev/null 2>&1; then echo "python$$version: not here, not tried"; continue; fi; \
	  echo "== $$(python$$version -V)"; venv=build/python-$$version; \
	  python$$version -m venv $$venv && $$venv/bin/pip install --quiet --upgrade pip && \
	  $$venv/bin/pip install --quiet --editable ".[seismic]" --group dev && \
	  OMP_NUM_THREADS=1 $$venv/bin/python -m pytest -q -p no:cacheprovider $(QUICK) || exit 1; \
	done

golden: dev ## the golden events anew, after a change that is meant to change results
	OMP_NUM_THREADS=1 $(BIN)/python tests/golden_events.py

build: dev
	$(BIN)/python -m build --no-isolation --wheel --outdir dist . # what builds it is in dev

# every file of the packages, with the folder that it lies in
files = cd $(1) && find $(2) -type f ! -path '*/__pycache__/*' | sort
wheel: build ## the wheel has all files, and works alone: in a fresh environment, away from the source
	rm -rf build/wheel && mkdir -p build/wheel
	$(PYTHON) -m venv build/wheel/venv
	$(call install,build/wheel/venv/bin/python,dist/groundtrace-*.whl)
	for folder in */groundtrace*/; do ( $(call files,$${folder%%/*},$$(basename $$folder)) ); done \
	  > build/wheel/source
	for package in $$(cut -d/ -f1 build/wheel/source | uniq); do \
	  ( $(call files,build/wheel/venv/lib/python*/site-packages,$$package) ); done | diff build/wheel/source -
	cd build/wheel && venv/bin/groundtrace demo

bench: dev
	$(BIN)/python bench/replay_speed.py
	$(BIN)/python bench/two_cores.py
	$(BIN)/python bench/startup.py
	$(BIN)/python bench/first_replay.py
	$(BIN)/python bench/whole_job.py --long
	$(BIN)/python bench/file_speed.py
	$(BIN)/python bench/sweep_speed.py
	$(BIN)/python bench/why_speed.py
	$(BIN)/python bench/localizers_speed.py
	$(BIN)/python bench/imu_speed.py
	$(BIN)/python bench/growth.py
	$(BIN)/python bench/localizers.py
	$(BIN)/python bench/pickers.py
	$(BIN)/python bench/room_tables.py
	$(BIN)/python bench/tracking.py
	$(BIN)/python bench/vehicle_tables.py
	$(BIN)/python bench/damage_table.py
	$(BIN)/python bench/timeline_size.py

fuzz: dev ## 100 000 mutated inputs for every parser; findings are kept in build/fuzz
	$(call install,$(BIN)/python,atheris)
	nice $(BIN)/python bench/fuzz.py --inputs 100000 --out build/fuzz

big: dev ## memory and time of every command on an hour of recording, and of importing 2 GB
	$(BIN)/python bench/big_memory.py
	$(BIN)/python bench/import_memory.py

accept: dev sweeps ## steps of real recordings (GROUNDTRACE_DATA), places in random rooms; the targets
	$(BIN)/python bench/step_accuracy.py
	$(BIN)/python bench/room_accuracy.py
	$(BIN)/python bench/placement_guess.py
	$(BIN)/python bench/foot_accuracy.py
	$(BIN)/python bench/lost_samples.py
	$(BIN)/python bench/lost_packets.py
	$(BIN)/python bench/heading_accuracy.py
	$(BIN)/python bench/pedestrian_accuracy.py
	$(BIN)/python bench/vehicle_accuracy.py
	$(BIN)/python bench/why_confusion.py

excerpts: dev ## the bundled excerpts of real recordings anew (GROUNDTRACE_DATA)
	$(BIN)/python bench/excerpts.py recordings/groundtrace_recordings

proto: dev ## the committed descriptors, from the .proto
	cd codecs/groundtrace_codecs/schemas && ../../../$(BIN)/python -m grpc_tools.protoc -I . \
	  --include_imports --descriptor_set_out=groundtrace.desc groundtrace.proto

docs: dev ## the site of the documentation, in build/site; a warning is an error
	$(call install,$(BIN)/python,--group docs)
	rm -rf build/site build/site-src && mkdir -p build && cp -r docs build/site-src
	$(BIN)/sphinx-build -q -W -n --keep-going -b html build/site-src build/site

pictures: $(VENV)/installed ## those in the README and the docs
	mkdir -p build
	$(BIN)/groundtrace replay --rrd build/room-walk.rrd --out build/room-walk.results.mcap --force
	$(BIN)/python -P -m groundtrace_viewers build/room-walk.rrd docs/screenshot.png --at 8.0425
	$(BIN)/groundtrace replay lower-back --rrd build/lower-back.rrd --out build/lower-back.results.mcap --force
	$(BIN)/python -P -m groundtrace_viewers build/lower-back.rrd docs/walker.png --at 8.65 --size 1280x720
	for name in phone-indoor phone-hand shots vehicle-pass; do $(BIN)/groundtrace replay $$name --rrd build/$$name.rrd \
	  --out build/$$name.results.mcap --force || exit; done
	$(BIN)/python -P -m groundtrace_viewers build/phone-indoor.rrd docs/images/walker-track.png --at 30 --size 1280x720
	$(BIN)/python -P -m groundtrace_viewers build/phone-hand.rrd docs/images/first-recording.png --at 30 --size 1280x720
	$(BIN)/python -P -m groundtrace_viewers build/shots.rrd docs/images/shots.png --at 0.05 --size 1280x720
	$(BIN)/python -P -m groundtrace_viewers build/vehicle-pass.rrd docs/vehicle.png --at 15 --size 1280x720
	$(BIN)/groundtrace figure build/lower-back.results.mcap --step 2 -o docs/images/missed-step.png --dpi 150
	$(BIN)/groundtrace sweep build/lower-back.results.mcap --grid steps.score=0.05:0.5:10 \
	  --grid steps.apart=0.2:0.5:7 --figure docs/images/sweep.svg --force
	$(BIN)/python bench/tables_drawn.py
	$(BIN)/python bench/page_pictures.py docs/images

clean:
	find . -name "kernels-*" -path "*/__pycache__/*" -prune -exec rm -rf {} +
	rm -rf $(VENV) build dist
