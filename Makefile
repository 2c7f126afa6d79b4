# Each target works on a fresh clone: it makes .venv (Python 3.12), installs what it needs and does its job.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.ONESHELL:

VENV := .venv
BIN := $(VENV)/bin
DEMO := outputs/demo
WORKERS ?= 2
PYTEST_ARGS ?=

# Two processes that share two cores must not each start a thread per core.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Nothing here needs the Hugging Face Hub.
export HF_HUB_OFFLINE ?= 1
export HF_HUB_DISABLE_TELEMETRY ?= 1

.PHONY: help install demo test lint clean

help:
	@echo "make install   .venv with the package and all extras"
	@echo "make demo      five demonstrations, one or more with a regrasp, as a LeRobot dataset, under $(DEMO)"
	@echo "make test      the test suite"
	@echo "make lint      ruff, pyright, import-linter"
	@echo "make clean     remove .venv, caches and outputs"

$(BIN)/python:
	@for candidate in python3.12 "$$HOME"/.pyenv/versions/3.12*/bin/python3.12 /usr/local/bin/python3.12 \
	        "$$(uv python find 3.12 2>/dev/null || true)" python3; do
	    if [ -n "$$candidate" ] && "$$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; then
	        python="$$candidate"; break
	    fi
	done
	if [ -z "$${python:-}" ]; then
	    echo "No Python 3.12 found: install it (pyenv install 3.12, or uv python install 3.12) and run make again." >&2
	    exit 1
	fi
	rm -rf $(VENV)
	"$$python" -m venv $(VENV) || {
	    rm -rf $(VENV)
	    echo "Python's venv module does not work (on Debian and Ubuntu it is the package python3.12-venv)." >&2
	    exit 1
	}

$(VENV)/.installed-all: $(BIN)/python pyproject.toml constraints.txt
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off -c constraints.txt -e '.[all]'
	$(ensure_egl)
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed-all
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off -c constraints.txt -e '.[all,dev]'
	touch $@

# Images are rendered without a display, through EGL. Mesa's two libraries are enough on a machine without a GPU.
define ensure_egl
egl_works() { MUJOCO_GL=egl $(BIN)/python -c 'import mujoco; mujoco.GLContext(8, 8).make_current()' 2>/dev/null; }
if ! egl_works; then
    apt=""
    if command -v apt-get >/dev/null; then
        if [ "$$(id -u)" = 0 ]; then apt="apt-get"; elif sudo -n true 2>/dev/null; then apt="sudo -n apt-get"; fi
    fi
    if [ -n "$$apt" ]; then
        echo "No working EGL: installing libegl1 and libgl1-mesa-dri."
        { $$apt update -qq && DEBIAN_FRONTEND=noninteractive $$apt install -y -qq --no-install-recommends libegl1 libgl1-mesa-dri; } || true
    fi
    if ! egl_works; then
        echo "WARNING: no working EGL, so nothing can be rendered without a display. Install libegl1 and libgl1-mesa-dri" >&2
        echo "         (Debian, Ubuntu) or your GPU's EGL driver; with a display, MUJOCO_GL=glfw works too." >&2
    fi
fi
endef

install: $(VENV)/.installed-all

demo: $(VENV)/.installed-all
	@rm -rf $(DEMO)
	mkdir -p $(DEMO)
	$(BIN)/regrasp-collect --env regrasp_gym/PandaYCB-v0 --episodes 5 --require-regrasp 1 --workers $(WORKERS) \
	    --root $(DEMO)/dataset --video $(DEMO)/episode.mp4 --plan-picture $(DEMO)/plan.png --json $(DEMO)/collect.json
	$(BIN)/regrasp-replay --root $(DEMO)/dataset --json $(DEMO)/replay.json

test: $(VENV)/.installed-dev
	@$(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

lint: $(VENV)/.installed-dev
	@status=0
	$(BIN)/ruff check . || status=1
	$(BIN)/ruff format --check . || status=1
	$(BIN)/pyright || status=1
	$(BIN)/lint-imports || status=1
	exit $$status

clean:
	@rm -rf $(VENV) outputs .pytest_cache .ruff_cache .hypothesis .import_linter_cache
