# Everything a person runs. `make demo` and `make test` set up what they need.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
# Of what is installed little is ever imported: Python compiles that when it is.
PIP    := --quiet --disable-pip-version-check --no-compile

# What the system lacks is installed by its package manager where that is allowed; else it is said.
define INSTALL
{ lacking="$(1)"; \
if command -v apt-get >/dev/null && { [ "$$(id -u)" = 0 ] || { command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; }; }; then \
	[ "$$(id -u)" = 0 ] && as="" || as=sudo; \
	echo "$$lacking is not installed: apt-get install $$lacking"; \
	$$as apt-get update -qq && $$as apt-get install -y -qq --no-install-recommends $$lacking; \
else echo "$$lacking is not installed; on Debian run: sudo apt-get install $$lacking"; exit 1; fi; }
endef

.PHONY: help engine setup demo demo-dcs460 test slow times quick wheel check bench evidence manual docs lock lowest audit vendor clean

help:
	@echo "make demo    simulate a flight, record it, process it, compare with the truth"
	@echo "make demo-dcs460  calibrate a camera from published observations, write its certificate"
	@echo "make test    run the tests: all that take seconds, in some minutes"
	@echo "make slow    run those that take longer: real flights, pages in a browser, installed wheels"
	@echo "make times   run all of them, and write down which take long"
	@echo "make quick   while working: the tests of the rooms that have changed"
	@echo "make wheel   build the wheel into dist/"
	@echo "make check   ruff and mypy --strict"
	@echo "make bench   measure speed"
	@echo "make evidence  the statistical studies, into docs/evidence, and the longest tests"
	@echo "make manual  renew the command pages and the figure of the architecture"
	@echo "make docs    the docs as a site, into build/site"
	@echo "make setup   only install (.venv, locked packages, compiled kernels)"
	@echo "make lowest  test with the lowest versions that pyproject.toml allows"
	@echo "make audit   licences, hashes, wheels per platform, bill of materials, two builds of one wheel"
	@echo "make vendor  fetch the libraries of the pages anew, with npm"
	@echo "make lock    renew requirements.lock from pyproject.toml"

setup: $(READY)

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "photocal needs Python 3.11 or newer; run: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || $(call INSTALL,python3-venv)
	@[ ! -L $(VENV) ] || { echo "$(VENV) is a link, and what it points to would be emptied; remove the link"; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install $(PIP) --require-hashes -r requirements.lock
	$(BIN)/python -m pip install $(PIP) --no-deps --no-build-isolation -e .
	$(BIN)/python -m photocal.base.compiled
	@touch $(READY)

# The PPK engine; tests that need it are left out with that reason where it is missing.
engine:
	@{ command -v rnx2rtkp && command -v convbin; } >/dev/null || $(call INSTALL,rtklib)

demo: engine $(READY)
	$(BIN)/python -m photocal.demo

demo-dcs460: $(READY)
	$(BIN)/python -m photocal.demo dcs460

# The tests' matrices are small: threads of the linear algebra would only wait for each other. Tests of one
# file stay together, so that what they share is made once; slow files go first, wherever they have few tests.
# To have each assertion tell its values costs every worker as much as a hundred tests: what fails runs again so.
# What is left for `make slow` and `make evidence` stands in tests/times.txt.
PYTEST  := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest
BESIDE  := -n auto --dist loadfile --no-loadscope-reorder --assert plain
AGAIN   := $(PYTEST) --last-failed --last-failed-no-failures none
test: $(READY)
	$(PYTEST) $(BESIDE) -m "not slow and not long" || { $(AGAIN); exit 1; }

slow: $(READY)
	$(PYTEST) $(BESIDE) -m "slow and not long" || { $(AGAIN); exit 1; }

# All of them, with nothing beside: writes tests/times.txt anew.
times: $(READY)
	$(PYTEST) $(BESIDE) --write-times

# Rooms that differ from the main branch, their tests and those that import what has changed.
quick: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.quick

# Without the developers' environment: pip fetches the builder, and nothing else.
wheel:
	rm -rf build/lib build/bdist.*
	$(PYTHON) -m venv --clear .wheel-venv
	.wheel-venv/bin/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w dist .
	rm -rf .wheel-venv

# The types of other systems are checked beside those of this one.
MYPY := $(BIN)/mypy --explicit-package-bases
check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@( for system in win32 darwin; do \
		$(MYPY) --cache-dir .mypy_cache/$$system --platform $$system acquire drivers photocal || exit 1; \
	done ) & others=$$!; \
	$(MYPY); here=$$?; wait $$others && exit $$here

bench: $(READY)
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only

evidence: $(READY)
	for study in tests/evidence/*.py; do $(BIN)/python -m tests.evidence.$$(basename $$study .py) || exit 1; done
	$(PYTEST) $(BESIDE) -m long

manual: $(READY)
	$(BIN)/python -m tests.docs

# The site of the docs, in build/site; MkDocs has an environment of its own.
docs: $(READY)
	[ -x .docs-venv/bin/mkdocs ] || { $(PYTHON) -m venv --clear .docs-venv && .docs-venv/bin/python -m pip install $(PIP) --require-hashes -r docs/requirements.lock; }
	$(BIN)/python -m tests.docs.site
	NO_MKDOCS_2_WARNING=1 .docs-venv/bin/mkdocs build --quiet -f build/mkdocs.yml
	@echo "open build/site/index.html"

vendor: $(READY)
	$(BIN)/python -m tests.vendor

lock:
	$(PYTHON) -m venv --clear .lock-venv
	.lock-venv/bin/python -m pip install --quiet pip-tools
	.lock-venv/bin/pip-compile --quiet --all-extras --generate-hashes --allow-unsafe --strip-extras \
	    --no-emit-index-url --no-emit-find-links --no-header --no-annotate --all-build-deps -o requirements.lock pyproject.toml
	.lock-venv/bin/pip-compile --quiet --generate-hashes --allow-unsafe --strip-extras \
	    --no-emit-index-url --no-emit-find-links --no-header --no-annotate -o docs/requirements.lock docs/requirements.in
	rm -rf .lock-venv

# Rooms that are fast and together use every dependency. Packages of then warn about those of today.
LOWEST ?= tests/drivers tests/acquire/importing tests/photocal/block tests/photocal/geometry tests/photocal/analysis/accuracy \
	tests/photocal/exchange tests/photocal/commands/test_adjust_errors.py tests/photocal/report/test_forgery.py
lowest:
	$(PYTHON) -m venv --clear .lowest-venv
	.lowest-venv/bin/python -m pip install $(PIP) uv
	.lowest-venv/bin/uv pip compile --quiet --resolution lowest-direct --all-extras --python-version 3.11 \
	    -o .lowest-venv/lowest.txt pyproject.toml
	.lowest-venv/bin/uv pip install --quiet --python .lowest-venv/bin/python --only-binary :all: \
	    -r .lowest-venv/lowest.txt "setuptools>=77"
	.lowest-venv/bin/python -m pip install $(PIP) --no-deps --no-build-isolation -e .
	OPENBLAS_NUM_THREADS=1 .lowest-venv/bin/python -m pytest -q --assert plain -o filterwarnings= $(LOWEST)

# The maker of the bill of materials has an environment of its own: it is no part of what is delivered.
audit: $(READY)
	$(PYTHON) -m venv --clear .audit-venv
	.audit-venv/bin/python -m pip install $(PIP) cyclonedx-bom==7.5.0
	$(BIN)/python -m tests.audit .audit-venv/bin/cyclonedx-py
	rm -rf .audit-venv

clean:
	rm -rf $(VENV) .lock-venv .lowest-venv .audit-venv .docs-venv .wheel-venv .mavproxy build dist *.egg-info demo-output
