# `make demo` and `make test` are all that a fresh machine needs: both first install what is missing.

CONSOLE := .ci/console service/openapi.json $(shell find service/console/web -type f \
	-not -path '*/node_modules/*' -not -path '*/generated/*')

MANUAL := .ci/docs $(shell find docs -type f -not -path '*/__pycache__/*')

.PHONY: help setup demo quick test soak fuzz serve lint docs pictures api-examples bench wheel licences lock clean

help:
	@echo 'make demo    a live scan by the simulated cell, the string in it recognised, the result and the best grasp shown'
	@echo 'make quick   run the quick tests of the library and the cell, within a minute'
	@echo 'make test    run all tests'
	@echo 'make soak    the tests that take long, hours of them: hundreds of scans, stops, faults, kills'
	@echo 'make fuzz    call every operation of the service in 1,000 odd ways; takes long'
	@echo 'make serve   start the HTTP service'
	@echo 'make lint    check style, types and the direction of imports'
	@echo 'make docs    build the manual, which the service serves at /manual'
	@echo 'make bench   measure speed, the simulated cell, the service under load, and accuracy'
	@echo 'make pictures  take the pictures of the console again, check all its states in build/pictures, and measure how soon it appears'
	@echo 'make api-examples  record the examples in the description of the API again, and write openapi.json'
	@echo 'make setup   make .venv, the console and the manual; the others do this first when needed'
	@echo 'make wheel   build two wheels into dist/: the package, with console and manual, and the client'
	@echo 'make licences  write LICENCES.md again: what each package may be used for'
	@echo 'make lock    write requirements.lock again from pyproject.toml; UPGRADE=1 takes newer versions'
	@echo 'make clean   remove what these commands made'

setup: .venv/.ready service/console/built/.ready service/manual/.ready

# Made again when what it depends on changes.
.venv/.ready: requirements.lock pyproject.toml service/client/pyproject.toml .python-version .ci/setup
	@.ci/setup
	@touch $@

# The operator's console, which needs the packages for its building.
service/console/built/.ready: $(CONSOLE) | .venv/.ready
	@.ci/console
	@touch $@

# The manual. The API reference and some pages come from the code, which is not listed here: `make docs` always builds.
service/manual/.ready: $(MANUAL) | service/console/built/.ready
	@.ci/docs
	@touch $@

docs: service/console/built/.ready
	@.ci/docs
	@touch service/manual/.ready

demo: .venv/.ready
	@.venv/bin/pointchain demo

# Tests of the library and the cell without processes, for the inner loop. Those marked `slow` take most of the time.
quick: .venv/.ready
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/pytest -n auto tests/recognition tests/calibration tests/cell \
		-m 'not slow and not xdist_group and not soak and not hardware and not fuzz'

# As many processes as cores: sums by several threads in each would only take the cores from one another.
test: setup
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/pytest -n auto

soak: setup
	@.venv/bin/pytest -m soak

fuzz: setup
	@.venv/bin/pytest -s -m fuzz

serve: setup
	@.venv/bin/pointchain serve

lint: setup
	@.venv/bin/ruff check
	@.venv/bin/ruff format --check
	@.venv/bin/pyright
	@.venv/bin/lint-imports --no-logo
	@.ci/console check

pictures: setup
	@.venv/bin/python -m tests.service.console.pictures

# The description contains the examples, so it is written after them.
api-examples: .venv/.ready
	@.venv/bin/python -m tests.service.api.record_examples
	@.venv/bin/python -m service.app >service/openapi.json.new
	@mv service/openapi.json.new service/openapi.json

bench: .venv/.ready
	@.venv/bin/pointchain bench

# By the packages of the lock, without a build environment of its own, which would fetch others.
wheel: service/console/built/.ready docs
	@.ci/setup uv
	@rm -rf build/lib service/client/build  # what is renamed would stay in the wheel
	@PATH=".uv/bin:$$PATH" uv build --quiet --no-build-isolation --python .venv --out-dir dist
	@PATH=".uv/bin:$$PATH" uv build --quiet --no-build-isolation --python .venv --out-dir dist service/client
	@ls dist/*.whl

licences: .venv/.ready
	@.venv/bin/python .ci/licences > LICENCES.md

# For every platform, with hashes, and without the address of an index: it installs from whichever
# index the machine is set up for.
lock:
	@.ci/setup uv
	@PATH=".uv/bin:$$PATH" uv pip compile --quiet --no-config --universal --python-version 3.11 \
		--all-extras --generate-hashes --custom-compile-command 'make lock' $(if $(UPGRADE),--upgrade) \
		--output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv .uv demo build dist service/client/build service/client/*.egg-info service/manual service/console/built service/console/web/node_modules service/console/web/generated *.egg-info .pytest_cache .ruff_cache .hypothesis .schemathesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
