# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

# Needs python3 (3.11 or 3.12) and make; everything else goes into $(VENV).
PYTHON ?= python3
VENV ?= .venv
OUT ?= out

# A sourced ROS 2 Jazzy is used as it is; otherwise ROS comes from wheels, into the same $(VENV).
ifeq ($(ROS_DISTRO),jazzy)
VENV_OPTIONS := --system-site-packages
DEMO_EXTRAS := live
else
VENV_OPTIONS :=
DEMO_EXTRAS := ros,live
endif

# The demos need a fifth of what tests, training and the documentation need: no torch above all.
# Each of the three holds what the next one needs.
INSTALLED := $(VENV)/.installed-$(ROS_DISTRO)
INSTALLED_LOOP := $(VENV)/.installed-demo-loop-$(ROS_DISTRO)
INSTALLED_DEMO := $(VENV)/.installed-demo-$(ROS_DISTRO)
# ROS from wheels beside a sourced ROS would load the libraries of both into one process: a $(VENV)
# made for the other one, or left half-made, is made again.
CLEAR = $(if $(wildcard $(VENV)/pyvenv.cfg),$(if $(wildcard $(VENV)/.installed*-$(ROS_DISTRO)),,--clear))
# Two numerical threads on two cores leave none for DDS and the executor.
RUN := OMP_NUM_THREADS=1 PATH="$(abspath $(VENV))/bin:$$PATH"

# More than there are cores, since tests of nodes mostly wait; a file each, the longest first. A
# worker that crashes ends the run: one in its place would leave the last tests waiting for ever.
TOGETHER := -n 3 --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# What the tests saw of bad input and faults, for docs/api/faults.md.
FAULTS ?= $(OUT)/faults.json
SECONDS ?= 60

.PHONY: help setup setup-demo setup-loop live demo demo-loop test faults fuzz lint docs canary results clean

help:
	@echo "make setup   everything into $(VENV); the demos install what they need alone"
	@echo "make live    the sensor in the browser: drag an indenter over it"
	@echo "make demo    the node, real presses replayed into it, a bag and a video in $(OUT)/demo"
	@echo "make demo-loop   a policy follows a path by touch; a bag, a picture and a report"
	@echo "make test    all tests, with real nodes over real DDS"
	@echo "make fuzz    hostile input for every reader, for SECONDS (60)"
	@echo "make faults  docs/api/faults.md, the answers to bad input and faults, from the tests"
	@echo "make lint    ruff, codespell, mypy and the arrows between modules"
	@echo "make docs    the documentation as a site in $(OUT)/site, with every link checked"
	@echo "make canary  eight short motions, compared with kept values; KEEP=1 keeps new ones"
	@echo "make results   the tables of docs/results, for a release: NAMES=\"gap rl\" for some, LIST=1 to list"

setup: $(INSTALLED)

setup-loop: $(or $(wildcard $(INSTALLED)),$(INSTALLED_LOOP))

setup-demo: $(or $(wildcard $(INSTALLED)),$(wildcard $(INSTALLED_LOOP)),$(INSTALLED_DEMO))

$(INSTALLED): EXTRAS := $(DEMO_EXTRAS),learning,test,dev,docs
$(INSTALLED_LOOP): EXTRAS := $(DEMO_EXTRAS),arm
$(INSTALLED_DEMO): EXTRAS := $(DEMO_EXTRAS)
$(INSTALLED) $(INSTALLED_LOOP) $(INSTALLED_DEMO): setup.py
	@case "$(ROS_DISTRO)" in ''|jazzy) ;; *) echo "dotsim_ros needs ROS 2 Jazzy, $(ROS_DISTRO) is sourced: use a shell without it" >&2; exit 1;; esac
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; v in ((3, 11), (3, 12)) or sys.exit("dotsim_ros needs Python 3.11 or 3.12, this is %d.%d: make PYTHON=python3.12" % v)'
	$(PYTHON) -m venv $(VENV_OPTIONS) $(CLEAR) $(VENV)
	@rm -f $(VENV)/.installed-*
	$(VENV)/bin/python -m pip install --quiet --no-compile --editable ".[$(EXTRAS)]"
	@touch $@

live: setup-demo
	$(RUN) dotsim_ros live --open --out $(OUT)/live

demo: setup-demo
	$(RUN) dotsim_ros demo --out $(OUT)/demo

demo-loop: setup-loop
	$(RUN) dotsim_ros demo-loop --out $(OUT)/demo-loop

# Each part runs, whatever those before it found.
test: setup
	@rm -f $(FAULTS)
	export $(RUN); tests="python -m pytest -rs --faults=$(FAULTS) $(PYTEST_OPTIONS)"; failed=0; \
	$$tests $(TOGETHER) -m "not timed" test || failed=1; \
	$$tests -m timed test/ros || failed=1; \
	exit $$failed

faults: setup
	@rm -f $(FAULTS)
	$(RUN) python -m pytest -rs -m fault --faults=$(FAULTS) $(PYTEST_OPTIONS) test
	$(RUN) python .ci/faults_table.py $(FAULTS)

# Another SEED gives other cases.
fuzz: setup
	$(RUN) python -m fuzz --seconds $(SECONDS) --seed $(or $(SEED),0)

lint: setup
	$(RUN) ruff check
	$(RUN) ruff format --check
	$(RUN) codespell
	$(RUN) codespell --dictionary .ci/words.txt
	$(RUN) mypy
	$(RUN) lint-imports

# KEEP=1 writes new values; the commit that does so says why they changed.
canary: setup
	$(RUN) python tools/canary.py $(if $(KEEP),--keep)

# For a release; resumed where it was interrupted.
results: setup
	$(RUN) python -m studies $(if $(LIST),,$(or $(NAMES),all) --json docs/results)
	$(RUN) python -m studies.results_page

# A notice of the theme's makers about its successor is no warning about these pages.
docs: setup
	$(RUN) python .ci/effects_table.py --check
	$(RUN) python -m studies.results_page --check
	NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --strict --quiet --site-dir $(abspath $(OUT))/site
	$(RUN) python .ci/check_links.py $(OUT)/site $(wildcard *.md)
	@echo "open $(OUT)/site/index.html"

clean:
	rm -rf $(OUT) build install log
