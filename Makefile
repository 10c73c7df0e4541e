# What people type. `make help` lists it.
MAKEFLAGS += --no-print-directory
SHELL := /bin/sh
BIN := .venv/bin
PYTHON := $(CURDIR)/$(BIN)/python
# test_trial_log writes a trial file here, which test_ulog_format reads.
export TRIAL_LOG_OUT := $(CURDIR)/build/test_trial.ulg
# Says every few seconds that a long command is still at work.
STEP := tools/step
PIP_INSTALL := $(PYTHON) -m pip install --disable-pip-version-check --no-build-isolation --no-deps \
	--force-reinstall
NEWLIB_LICENSE := /usr/share/doc/libnewlib-arm-none-eabi/copyright
CONFIGURE := $(STEP) configuring cmake -S . -G Ninja -DPython_EXECUTABLE=$(PYTHON) --log-level=WARNING
# Folders, too: a file may go. Not the uppermost: Python keeps there what tests compiled.
PACKAGE_SOURCES := CMakeLists.txt $(shell find host firmware hal sim wire tools/vboard cmake -mindepth 1 -not -name __pycache__ \
	-not -name '*.pyc' -not -path '*/.*_cache*')
C_SOURCES = $(shell find firmware hal sim bench tests/unit tests/conformance tests/fuzz tests/image host/native tools/vboard/native \
	-name '*.[ch]' 2>/dev/null)
PYTHON_SOURCES := $(wildcard docs/*.py docs/diagrams/*.py) host tests tools wire $(wildcard bench examples)

# Runs all that it is given, whatever fails, and sums up.
RUN_ALL := $(BIN)/python tools/run_all.py
# CPU seconds of all tests, their builds included, on the machine of the budget. They take 530 to 670 s
# there, the most with everything to build; on a busy or slow machine up to a third more than the fixed work tells.
TEST_CPU_MAX_S := 880

# For what takes long on purpose: no limits of time (tests/conftest.py).
UNLIMITED := -o faulthandler_timeout=0

# Without what it has compiled kept, each process compiles all tests anew, for 15 s. One process more
# than cores would take 5 % more: each collects all tests and makes its own fixtures.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n $$(nproc) --dist worksteal

.PHONY: help demo test image qemu soak bench firmware sbom flash size check docs dist clean lock bootstrap package \
	unit trial_log host_tests coverage toolchain fuzz bench_programs conformance_programs smartfusion2

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16

demo: package ## a simulated fish learns the thesis's speed profile
	@$(BIN)/tailbeat sim demo

# What tests that run beside each other build in the same folder is built before them, and old to them.
TESTED := package firmware smartfusion2 conformance_programs
BUILT := $(foreach target,$(TESTED),--old-file=$(target))

test: toolchain ## all tests: C (sanitized, and on a Cortex-M3), host tool, flash image
	@$(RUN_ALL) --costs build/test_costs.txt --cpu-max $(TEST_CPU_MAX_S) --in-memory \
		--beside unit '$(MAKE) unit trial_log coverage' --beside qemu '$(MAKE) qemu' \
		--beside image '$(MAKE) $(BUILT) image' \
		builds '$(MAKE) $(TESTED)' 'host and system' '$(MAKE) $(BUILT) host_tests'

image: $(TESTED) ## only the tests of the flash image
	@tools/bootstrap image
	@$(PYTEST) tests/image

# The host tool, the whole system, and bench/ with a tiny load. A browser waits more than it computes,
# for a fish that swims: the tests of the page run beside the others.
host_tests: package firmware
	@tools/bootstrap test
	@$(BIN)/pytest tests/system/test_ui*.py >build/page_tests.txt 2>&1 & page=$$!; \
	$(PYTEST) tests/host tests/system --ignore-glob='*/test_ui*.py'; others=$$?; \
	wait $$page; page=$$?; echo "tests of the page:"; cat build/page_tests.txt; exit $$((others | page))

QEMU_ALL := OFF
CONFIGURE_QEMU = $(CONFIGURE) -B build/qemu -DTAILBEAT_NATIVE=OFF -DTAILBEAT_CHIP=smartfusion2 \
	-DTAILBEAT_QEMU_ALL=$(QEMU_ALL) --toolchain $(CURDIR)/cmake/qemu-mps2.cmake >/dev/null
qemu: ## the unit tests as Cortex-M3 code: those that a processor may change
	@tools/bootstrap qemu
	@$(CONFIGURE_QEMU)
	@$(STEP) "building the unit tests for QEMU" cmake --build build/qemu --target unit_tests
	@$(BIN)/python tests/unit/run.py build/qemu

soak: package firmware ## hours: power cuts by the ten thousand, wear, 10^7 random events, bad lines and bad trials
	@tools/bootstrap soak
	@$(CONFIGURE) -B build/unit -DTAILBEAT_SANITIZE=ON -DTAILBEAT_COVERAGE=ON \
		-DTAILBEAT_ALL_FLASHES=ON -DTAILBEAT_NATIVE=OFF >/dev/null
	@$(STEP) "building the unit tests" cmake --build build/unit --target unit_tests
	@$(BIN)/python tests/unit/run.py build/unit
	IMU_FUZZ_BYTES=100000000 build/unit/tests/test_imu_fuzz
	STORE_CUT_AGES=8 STORE_CUT_PAIRS=10000 build/unit/tests/test_power_cut
	APP_CUT_PAIRS=1000 build/unit/tests/test_app_cuts
	FLIP_STRIDE=1 FLIP_BITS=8 FLIP_LIFETIMES=20 FLIP_DAMAGE=1000 build/unit/tests/test_rollback
	WEAR_TRIALS=10000 build/unit/tests/test_wear
	for flash in nor4k nor64k; do \
		STORE_CUT_AGES=8 STORE_CUT_PAIRS=10000 build/unit/tests/test_power_cut_$$flash && \
		APP_CUT_PAIRS=1000 build/unit/tests/test_app_cuts_$$flash && \
		FLIP_STRIDE=1 FLIP_LIFETIMES=5 build/unit/tests/test_rollback_$$flash && \
		WEAR_TRIALS=1000 build/unit/tests/test_wear_$$flash || exit 1; done
	WALK_STEPS=10000000 WALK_SEED=2 build/unit/tests/test_supervisor_walk
	@$(BIN)/pytest -n auto --dist worksteal -s -m soak tests/image tests/host tests/system
	@$(MAKE) qemu QEMU_ALL=ON
	@for recipe in $$($(BIN)/tailbeat sim montecarlo --list --json | $(PYTHON) -c \
		'import json, sys; print(*(r["name"] for r in json.load(sys.stdin)["recipes"]))'); do \
		$(BIN)/tailbeat sim montecarlo $$recipe --out build/sweeps/$$recipe --pinned --check || exit 1; done
	@$(BIN)/python bench/sessions.py 200
	@$(BIN)/python bench/causes.py 10
	@$(BIN)/python bench/executions.py 100
	@FTP_MODEL_EXAMPLES=500 $(BIN)/pytest $(UNLIMITED) -s tests/host/link/test_ftp_model.py
	@$(MAKE) fuzz

fuzz: package ## bytes nobody sends: 10 minutes for each target, or FUZZ_SECONDS
	@tools/bootstrap fuzz
	@CC=clang $(CONFIGURE) -B build/fuzz -DTAILBEAT_SANITIZE=ON -DTAILBEAT_FUZZ=ON \
		-DTAILBEAT_WERROR=OFF -DTAILBEAT_NATIVE=OFF >/dev/null
	@$(STEP) "building the fuzzers" cmake --build build/fuzz --target fuzz_targets
	@$(PYTHON) tests/fuzz/run.py
	@mkdir -p build/fuzz/found
	@FUZZ_SECONDS=$${FUZZ_SECONDS:-600} FUZZ_KEEP=build/fuzz/found \
		$(PYTEST) $(UNLIMITED) -s tests/host/test_fuzz_files.py

bench: package firmware bench_programs ## speed of the simulation, load of the fish's processor, cost of an IMU byte
	@tools/bootstrap bench
	@$(RUN_ALL) tailbeat_bench build/bench/tailbeat_bench \
		$(foreach script,$(wildcard bench/*.py),$(script) '$(BIN)/python $(script)')

bench_programs: bootstrap
	@$(CONFIGURE) -B build/bench -DTAILBEAT_TESTS=OFF -DTAILBEAT_NATIVE=OFF >/dev/null
	@$(STEP) "building the benchmarks" cmake --build build/bench --target tailbeat_bench imu_reader_cost \
		imu_coverage

firmware: package ## the image that is flashed to the fish: build/firmware/tailbeat.bin
	@tools/bootstrap firmware
	@$(CONFIGURE) -B build/firmware -DTAILBEAT_TESTS=OFF -DTAILBEAT_NATIVE=OFF \
		--toolchain $(CURDIR)/cmake/cortex-m3.cmake
	@$(STEP) "building the firmware" cmake --build build/firmware --target tailbeat_image
	@mkdir -p build/firmware/licenses
	@cp host/NOTICE build/firmware/ && cp host/licenses/*.txt build/firmware/licenses/
	@cp $(NEWLIB_LICENSE) build/firmware/licenses/newlib.txt 2>/dev/null || \
		echo "newlib's license was not found; add it from your toolchain to build/firmware/licenses/newlib.txt"
	@echo "build/firmware/tailbeat.bin: $$(wc -c <build/firmware/tailbeat.bin) bytes"

# The conformance suite: an image for the fish's board, a program that is the simulated one.
conformance_programs: firmware
	@$(CONFIGURE) -B build/unit -DTAILBEAT_SANITIZE=ON -DTAILBEAT_COVERAGE=ON \
		-DTAILBEAT_NATIVE=OFF >/dev/null
	@$(STEP) "building the conformance suite" cmake --build build/firmware \
		--target sam3x8e_conformance sam3x8e_conformance_faulty
	@$(STEP) "building the conformance suite" cmake --build build/unit \
		--target simulated_conformance simulated_conformance_faulty

# The port that QEMU runs, with the firmware that the unit tests there link: it is compiled once.
smartfusion2: package
	@tools/bootstrap firmware
	@$(CONFIGURE_QEMU)
	@$(STEP) "building the SmartFusion2 port" cmake --build build/qemu --target smartfusion2_image

sbom: package ## everything built in or installed, as CycloneDX: build/sbom.json
	@$(PYTHON) tools/sbom.py

flash: firmware package ## write the image to the fish: make flash PORT=/dev/ttyACM0 FLASH_OPTIONS=--no-keep
	@tools/bootstrap flash
	@$(BIN)/tailbeat board flash build/firmware/tailbeat.bin --port "$(PORT)" $(FLASH_OPTIONS)

size: firmware ## bytes, biggest symbols, deepest stack; fails over the budgets
	@tools/bootstrap size
	@$(PYTHON) tools/size_report.py build/firmware/tailbeat.elf

check: ## formatting, types, static analysis, who includes whom, words and spelling
	@tools/bootstrap check
	@$(MAKE) package
	$(BIN)/ruff check --quiet $(PYTHON_SOURCES)
	$(BIN)/ruff format --quiet --check $(PYTHON_SOURCES)
	@$(STEP) mypy $(BIN)/mypy
	@$(STEP) clang-format $(BIN)/clang-format --dry-run -Werror $(C_SOURCES)
	$(BIN)/python tools/check_includes.py
	$(BIN)/python tools/check_prose.py
	@PYTHONPATH=host $(STEP) "layers of the host package" $(BIN)/lint-imports --no-cache
	@PYTHONPATH=host $(BIN)/python tools/check_architecture.py
	@$(STEP) "static analysis" tools/check_c

docs: package ## the documentation as web pages: build/docs/html/index.html
	@tools/bootstrap docs
	@$(STEP) "building the documentation" $(BIN)/python -m sphinx --builder html --fail-on-warning \
		--keep-going --quiet docs build/docs/html
	@echo "build/docs/html/index.html"

dist: firmware ## what is published: source distribution and wheels for five platforms, in build/dist
	@tools/bootstrap dist
	@$(STEP) "building the distribution" $(PYTHON) tools/dist.py $(PLATFORMS)
	@cat build/dist/SHA256SUMS

clean: ## remove everything that was built, but not .venv
	rm -rf build

lock: bootstrap ## pin the newest versions of the Python packages; with KEEP=1 the present ones
	@$(STEP) "installing uv" $(BIN)/python -m pip install --progress-bar off uv
	@$(STEP) "pinning the packages" $(PYTHON) tools/lock.py --uv $(BIN)/uv $(if $(KEEP),,--upgrade)

bootstrap:
	@tools/bootstrap

toolchain: # first, so that what is missing is installed in one go
	@tools/bootstrap test

package: bootstrap
	@$(MAKE) -s build/package.stamp

build/package.stamp: $(PACKAGE_SOURCES)
	@echo "building and installing the host tool into .venv"
	@mkdir -p build
	@$(STEP) "building the host tool" $(PIP_INSTALL) --verbose \
		--config-settings=build-dir=$(CURDIR)/build/wheel \
		--config-settings=cmake.define.TAILBEAT_WERROR=ON ./host
	@$(STEP) "installing the emulator" $(PIP_INSTALL) ./tools/vboard
	@touch $@

unit: bootstrap
	@$(CONFIGURE) -B build/unit -DTAILBEAT_SANITIZE=ON -DTAILBEAT_COVERAGE=ON \
		-DTAILBEAT_ALL_FLASHES=OFF -DTAILBEAT_NATIVE=OFF >/dev/null
	@$(STEP) "building the unit tests" cmake --build build/unit
	@find build/unit -name '*.gcda' -delete
	@$(BIN)/python tests/unit/run.py build/unit

trial_log: # what a C test wrote, as pyulog reads it
	@$(BIN)/pytest tests/unit/test_ulog_format.py

coverage:
	@echo "Line coverage of firmware/ by the unit tests:"
	@$(BIN)/gcovr --root . --filter firmware/ --object-directory build/unit \
		--gcov-ignore-errors=source_not_found --gcov-ignore-errors=no_working_dir_found \
		build/unit/CMakeFiles/tailbeat_firmware.dir
