# `make demo` and `make test` do all the set-up: own virtual environment, install once, run.
# The plain pip lines that do the same by hand stand in README.md. Needs Python 3.11+ and, for the first run, pip's index.
# What measures, proves and releases is reached by `make -C tools TARGET` with the same variables; `make -C tools` lists it.

VENV   ?= .venv
PYTHON ?= python3
PY     := $(VENV)/bin/python
STAMP  := $(VENV)/.texfcodec-installed
DEMO   := $(VENV)/.texfcodec-demo

unexport PYTHONDONTWRITEBYTECODE  # without it every process of the tests compiles all that it imports: a second each
.DELETE_ON_ERROR:
.PHONY: help demo test check conformance native wasm web site bench rate-points install clean

help:  # This list
	@sed -n 's/^\([a-z][a-z-]*\):.*# \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{ printf "%-20s %s\n", $$1, $$2 }'
	@echo "  make -C tools        lists the targets that measure, prove and release"

demo: $(DEMO)  # An environment, a vase, its stream and the way back, in one go
	$(PY) -m texfcodec.demo

# Three workers, for tests that wait for a browser or a process leave cores idle: 8.7 minutes on two cores in place of 9.4
test: conformance  # Every vector and all tests but the sweeps, in an environment of their own
	$(PY) -m pytest -q -n 3 --dist loadfile -m "not slow"

check: conformance  # Before a commit, three to five minutes: lint, every vector, and the tests that are quick
	$(PY) -m ruff check
	@if command -v npm >/dev/null && [ -e js/node_modules/.bin/eslint ]; then npm --prefix js --silent run check; else echo "js/ is not checked: npm or js/node_modules is missing (npm install in js/)"; fi
	$(PY) -m pytest -q -n 2 --dist loadfile -m "not slow and not long"

# Any decoder can be put through the vectors: make conformance DECODER="other-decoder --flag" [QUERIES=1]. Without one it is the
# package's, and the C++ one where `make native` has built it.
conformance: install  # The vectors through a decoder: [DECODER="other-decoder --flag"] [QUERIES=1]
	$(PY) conformance/run.py $(if $(DECODER),--decoder "$(DECODER)") $(if $(QUERIES),--queries)
	@if [ -n "$(DECODER)" ] || [ ! -e native/build/texf_dec ]; then exit; fi; $(MAKE) native PYTHON="$(PY)"

# The C++ decoder of native/, through every vector; the WebAssembly module of it that js/ and --isolate run (docs/guide/native.md)
native:  # The C++ decoder as command and library, built and put through every vector
	$(MAKE) -C native
	$(PYTHON) conformance/run.py --decoder native/build/texf_dec --queries
wasm:  # The WebAssembly module of it
	$(MAKE) -C native wasm

# The documentation as a site, in out/site: guide, design, reports, API reference, specification, gallery. Links are checked, and a
# broken one fails; nothing is fetched by the pages. Needs a minute or two to encode the gallery.
site: install  # The documentation as a site, in out/site
	$(PY) -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

# The page of texf-view as one script, of texfcodec/viewer/app, js/src and three.js; needs node, and npm's index
web:  # The page of texf-view, bundled with js/src and three.js
	npm --prefix js install --silent --no-audit --no-fund
	node texfcodec/viewer/app/bundle.mjs

# Kept in pytest-benchmark's own storage and compared with the run before: make bench [ONLY=expression] [OUT=folder]. Then
# .venv/bin/pytest-benchmark --storage out/benchmarks compare; against a commit in turns: python tools/bench/ab.py speed COMMIT .
bench: install  # Kernels, pipelines, pictures and processes on the demo asset, against the run before
	$(PY) -m pytest -q tools/bench --benchmark-only --benchmark-timer=time.process_time --benchmark-storage="$(or $(OUT),out/benchmarks)" --benchmark-autosave --benchmark-compare --benchmark-compare-fail=min:10% --benchmark-compare-fail=median:10% --benchmark-columns=min,median,rounds -W default::pytest_benchmark.logger.PytestBenchmarkWarning $(if $(ONLY),-k "$(ONLY)")

rate-points: install  # Assets at the settings of a condition file, then tables: [CONDITIONS=file] [ASSETS=folder] [JOBS=n] [OUT=folder]
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[baselines,plots]"
	$(PY) tools/bench/rate_points.py "$(or $(CONDITIONS),tools/conditions/smoke.toml)" --out "$(or $(OUT),out/rate_points)" $(if $(ASSETS),--assets "$(ASSETS)") $(if $(JOBS),--jobs $(JOBS))
	$(PY) tools/bench/collect.py "$(or $(OUT),out/rate_points)" --out "$(or $(OUT),out/rate_points)"

install: $(STAMP)  # The environment alone

# The stamp is written last: an interrupted install has none and is done again. An existing environment is completed, never
# wiped, so that VENV may name one's own.
define environment
	@command -v "$(PYTHON)" >/dev/null || { echo "texfcodec needs Python 3.11 or newer and found no '$(PYTHON)'; say which with: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "texfcodec needs Python 3.11 or newer; '$(PYTHON)' is `"$(PYTHON)" -V 2>&1`. Say which with: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@rm -f "$@"
	"$(PYTHON)" -m venv "$(VENV)" || { echo "no virtual environment could be made; on Debian and Ubuntu install python3-venv" >&2; exit 1; }
endef
# Python compiles what is imported; pip would compile all
PIP = "$(PY)" -m pip install --quiet --disable-pip-version-check --no-compile

$(STAMP): pyproject.toml
	$(environment)
	$(PIP) --editable ".[test]"
	@touch "$@"

# Half of what the tests need; one processor compiles kernels while the last of it, which the package itself is not, is unpacked
DEMO_NEEDS = `"$(PY)" -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["demo"])'`
$(DEMO): pyproject.toml
	$(environment)
	$(PIP) --editable .
	@"$(PY)" -m texfcodec.precompile encode save >/dev/null 2>&1 & trap "kill $$! 2>/dev/null" EXIT INT TERM; $(PIP) $(DEMO_NEEDS)
	@touch "$@"

clean:  # All that was built; an environment of your own stays
	@if [ "$(VENV)" = .venv ]; then rm -rf .venv; else echo "$(VENV) is yours: left alone" >&2; fi
	rm -rf build dist out .pytest_cache .hypothesis .ruff_cache .mypy_cache .benchmarks texfcodec.egg-info
	find texfcodec tests conformance tools -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true
