# `make demo` and `make test` do all the set-up: own virtual environment, install once, run.
# The plain pip lines that do the same by hand stand in README.md. Needs Python 3.11+ and, for the first run, pip's index.

VENV   ?= .venv
PYTHON ?= python3
PY     := $(VENV)/bin/python
STAMP  := $(VENV)/.texfcodec-installed
DEMO   := $(VENV)/.texfcodec-demo

.DELETE_ON_ERROR:
.PHONY: demo check test sweeps interrupts bench anchor tmc13 attribute-tools everyday rate-points results again accuracy-time neural stability strangers kinds three determinism load fuzz faults mutants coverage conformance vectors spec-tables promise native wasm web site install release clean

demo: $(DEMO)
	$(PY) -m texfcodec.demo

test: conformance
	$(PY) -m pytest -q -n 2 --dist loadfile -m "not slow"

# Before a commit, three to five minutes: lint, every vector, and the tests that are quick
check: conformance
	$(PY) -m ruff check
	@if command -v npm >/dev/null && [ -e js/node_modules/.bin/eslint ]; then npm --prefix js --silent run check; else echo "js/ is not checked: npm or js/node_modules is missing (npm install in js/)"; fi
	$(PY) -m pytest -q -n 2 --dist loadfile -m "not slow and not long"

# What test leaves out: bounds checked, without the JIT, many random moments, real assets; twenty minutes or more
sweeps: install
	$(PY) -m pytest -q -n 2 --dist loadfile -m slow

# Any decoder can be put through the vectors: make conformance DECODER="other-decoder --flag" [QUERIES=1]. Without one it is the
# package's, and the C++ one where `make native` has fetched Draco's sources.
conformance: install
	$(PY) conformance/run.py $(if $(DECODER),--decoder "$(DECODER)") $(if $(QUERIES),--queries)
	@if [ -n "$(DECODER)" ] || [ ! -d native/build/draco ]; then exit; fi; $(MAKE) native PYTHON="$(PY)"

# The C++ decoder of native/, through every vector; the WebAssembly module of it that js/ and --isolate run (docs/guide/native.md)
native:
	$(MAKE) -C native
	$(PYTHON) conformance/run.py --decoder native/build/texf_dec --queries
wasm:
	$(MAKE) -C native wasm

# The documentation as a site, in out/site: guide, design, reports, API reference, specification, gallery. Links are checked, and a
# broken one fails; nothing is fetched by the pages. Needs a minute to encode the gallery.
site: install
	$(PY) -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

# The page of texf-view as one script, of texfcodec/viewer/app, js/src and three.js; needs node, and npm's index
web:
	npm --prefix js install --silent --no-audit --no-fund
	node texfcodec/viewer/app/bundle.mjs

# Every tool, interrupted (or killed) at random moments of its run: make interrupts [MOMENTS=300] [JOBS=n] [KILL=1]
interrupts: install
	$(PY) tests/interrupts.py --moments $(or $(MOMENTS),300) $(if $(JOBS),--jobs $(JOBS)) $(if $(KILL),--kill)

# Kernels, pipelines, pictures and metrics on the demo asset, kept as a line of a history and compared with the line before it on
# this machine: make bench [BEFORE=commit] [OUT=file.jsonl] [PAGE=docs/reports/bench.md]; against a commit in turns: make bench TURNS=commit
bench: install
ifdef TURNS
	@$(PY) tools/bench/turns.py $(TURNS)
else
	@mkdir -p "$(dir $(or $(OUT),out/bench.jsonl))"
	$(PY) -m pytest -q tools/bench --benchmark-only --benchmark-timer=time.process_time --benchmark-json="$(or $(OUT),out/bench.jsonl).last"
	@$(PY) tools/bench/history.py "$(or $(OUT),out/bench.jsonl)" --append "$(or $(OUT),out/bench.jsonl).last" $(if $(BEFORE),--before $(BEFORE)) --compare $(if $(PAGE),--page "$(PAGE)")
endif

# Voxel clouds with anchor results, see tools/bench/anchor_bdrate.py: make anchor CLOUDS=folder [EFFORT=best]. JSON on stdout.
anchor: install
	@$(PY) tools/bench/anchor_bdrate.py --clouds "$(CLOUDS)" $(if $(EFFORT),--effort $(EFFORT)) --json

# The rival on voxels, TMC13, from the MPEG group's public sources; needs git, cmake and a C++ compiler: make tmc13 [OUT=folder] [FROM=address]
TMC13 = $(abspath $(or $(OUT),out/tmc13))
tmc13:
	[ -d "$(TMC13)" ] || git clone --quiet --depth 1 --branch release-v23.0-rc2 "$(or $(FROM),https://github.com/MPEGGroup/mpeg-pcc-tmc13)" "$(TMC13)"
	cmake -S "$(TMC13)" -B "$(TMC13)/build" -DCMAKE_BUILD_TYPE=Release
	cmake --build "$(TMC13)/build" --target tmc3 --parallel 2
	@echo 'Rows of TMC13 are measured with: export TEXFCODEC_TMC13="$(TMC13)/build/tmc3/tmc3"'

# What each tool of the attribute codec is worth, a Markdown table: make attribute-tools CLOUDS=folder [EFFORT=best] [OUT=file]
attribute-tools: install
	@$(PY) tools/bench/attribute_tools.py --clouds "$(CLOUDS)" $(if $(EFFORT),--effort $(EFFORT)) $(if $(OUT),--out "$(OUT)")

# Against Draco with AVIF, WebP or JPEG at equal image PSNR, a Markdown table; an hour, and curves of other assets are made with
# tools/bench/everyday.py curves: make everyday ASSETS=folder [ANCHORS=folder] [OUT=file]
everyday: install
	@mkdir -p "$(dir $(or $(OUT),out/everyday.json))"
	$(PY) tools/bench/everyday.py measure "$(ASSETS)"/*.glb --out "$(or $(OUT),out/everyday.json)"
	@$(PY) tools/bench/everyday.py compare --anchors tools/bench/everyday $(if $(ANCHORS),--anchors "$(ANCHORS)") --points "$(or $(OUT),out/everyday.json)"

# Every asset at every setting of a condition file, then tables: make rate-points [CONDITIONS=file] [ASSETS=folder] [JOBS=n] [OUT=folder]
rate-points: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[baselines,plots]"
	$(PY) tools/bench/rate_points.py "$(or $(CONDITIONS),tools/conditions/smoke.toml)" --out "$(or $(OUT),out/rate_points)" $(if $(ASSETS),--assets "$(ASSETS)") $(if $(JOBS),--jobs $(JOBS))
	$(PY) tools/bench/collect.py "$(or $(OUT),out/rate_points)" --out "$(or $(OUT),out/rate_points)"

# docs/reports/results.md: every asset and the paper's rows against rivals; hours, resumable: make results ASSETS=folder [JOBS=n] [OUT=folder]
results: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[rivals,baselines]"
	for part in all_assets paper resident lossy_geometry; do $(PY) tools/bench/rate_points.py tools/conditions/$$part.toml --out "$(or $(OUT),out/results)/$$part" --assets "$(ASSETS)" $(if $(JOBS),--jobs $(JOBS)) || exit $$?; done
	$(PY) tools/bench/collect.py "$(or $(OUT),out/results)/paper" --against "UV-Source HEVC" --out "$(or $(OUT),out/results)"
	$(PY) tools/bench/paper_table.py --all "$(or $(OUT),out/results)/all_assets" --paper "$(or $(OUT),out/results)/paper" --resident "$(or $(OUT),out/results)/resident" --geometry "$(or $(OUT),out/results)/lossy_geometry" --assets "$(ASSETS)" --out docs/reports/results.md

# Whether the points that pages were made of still have the same bytes, encoded and not measured; half an hour and more, resumable:
# make again ASSETS=folder [JOBS=n] [PAGE=docs/reports/again.md]
again: install
	$(PY) tools/bench/again.py --assets "$(ASSETS)" $(if $(JOBS),--jobs $(JOBS)) $(if $(PAGE),--page "$(PAGE)")

# Which settings of the encoder pay, and what a second buys: make accuracy-time [ASSET="file or name ..."] [ASSETS=folder]
# [KNOB="name ..."] [QUICK=1] [REPEATS=n] [JOBS=n] [OUT=folder] [PAGE=docs/reports/accuracy_time.md]. Without ASSET the four of the page
# where ASSETS names their folder, else the sample.
accuracy-time: install
	$(PY) tools/bench/accuracy_time.py $(if $(ASSETS),--assets "$(ASSETS)") $(if $(or $(ASSET),$(if $(ASSETS),,sample)),--asset $(or $(ASSET),sample)) $(if $(KNOB),--knob $(KNOB)) $(if $(QUICK),--quick) $(if $(REPEATS),--repeats $(REPEATS)) $(if $(JOBS),--jobs $(JOBS)) --out "$(or $(OUT),out/accuracy_time)" $(if $(PAGE),--page "$(PAGE)")

# 3DNTC payloads against ASTC, and what their fitting time buys; about an hour: make neural [ASSETS=folder] [OUT=folder]
neural: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[baselines]"
	$(PY) tools/bench/rate_points.py tools/conditions/resident.toml --out "$(or $(OUT),out/resident)" $(if $(ASSETS),--assets "$(ASSETS)")
	$(PY) tools/bench/rate_points.py tools/conditions/neural_time.toml --out "$(or $(OUT),out/resident)" --keep-old $(if $(ASSETS),--assets "$(ASSETS)")
	$(PY) tools/bench/neural_time.py "$(or $(OUT),out/resident)" --out "$(or $(OUT),out/resident)"

# How far off hard cases can get: make stability [SECONDS=5] [CASE="name"] [MOST=1] [STATE=file.jsonl] [PAGE=docs/reports/stability.md]
stability: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[plots]"
	$(PY) tools/proof/stability --seconds $(or $(SECONDS),5) $(if $(CASE),--case "$(CASE)") $(if $(MOST),--most) $(if $(STATE),--state "$(STATE)") $(if $(PAGE),--page "$(PAGE)")

# Streams and decoded arrays over threads, versions, processors, locales and folders, a Markdown table:
# make determinism [ASSETS=folder] [ENVIRONMENTS=1] [PYTHONS="file ..."] [OUT=folder] [PAGE=docs/reports/determinism.md]
determinism: install
	$(PY) tools/proof/determinism.py $(if $(ASSETS),--assets "$(ASSETS)") $(if $(ENVIRONMENTS),--environments) $(foreach p,$(PYTHONS),--python "$(p)") --out "$(or $(OUT),out/determinism)" $(if $(PAGE),--page "$(PAGE)")

# Public models fetched by name and hash, coded, decoded and judged from outside; hours, resumable:
# make strangers [CACHE=folder] [ROUND=n] [MOST=n] [LARGEST=bytes] [JOBS=n] [RATE=r04] [ROWS=file.jsonl] [BEFORE=file.jsonl] [PICTURES=n]
# [PAGE=docs/reports/strangers.md KINDS=file.jsonl LADDERS=file.jsonl]; KINDS comes from make kinds
strangers: install
	$(PY) tools/proof/strangers --cache "$(or $(CACHE),out/strangers)" --keep-old $(if $(MOST),--most $(MOST)) $(if $(LARGEST),--largest $(LARGEST)) $(if $(JOBS),--jobs $(JOBS)) $(if $(ROWS),--rows "$(ROWS)") $(if $(BEFORE),--before "$(BEFORE)") $(if $(PICTURES),--pictures $(PICTURES)) $(if $(ROUND),--round $(ROUND)) $(if $(RATE),--rate $(RATE)) $(if $(PAGE),--page "$(PAGE)") $(if $(KINDS),--kinds "$(KINDS)") $(if $(LADDERS),--ladders "$(LADDERS)")

# Files in each of which one property is the only thing that shows, drawn by other programs: make kinds [CACHE=folder] [ROWS=file.jsonl]
kinds: install
	$(PY) -m tools.proof.strangers.kinds --cache "$(or $(CACHE),out/strangers)" $(if $(ROWS),--rows "$(ROWS)")

# Six assets by three.js and by our renderer, a Markdown table: make three ASSETS=folder [ALIKE=all] [OUT=folder]
three: install
	$(PY) tools/proof/three_check.py "$(ASSETS)" $(foreach name,$(ALIKE),--alike $(name)) --out "$(or $(OUT),out/three)"

# Memory over 500 calls, 8 processes at once, a batch with faults, memory of refused files, many faces, tasks of a Dask cluster:
# make load [PART="slope ..."] [LARGE=1] [OUT=folder] [PAGE=docs/reports/load.md]
load: install
	$(PY) tools/proof/load.py $(foreach p,$(PART),--part $(p)) $(if $(LARGE),--large) --out "$(or $(OUT),out/load)" $(if $(PAGE),--page "$(PAGE)")

# Fuzz targets of the decoder and the loaders: make fuzz [SECONDS=20] [TARGET="name ..."] [OUT=folder] [PAGE=docs/reports/fuzzing.md]
fuzz: install
	$(PY) tests/fuzz/run.py --seconds $(or $(SECONDS),20) $(foreach name,$(TARGET),--target $(name)) --out "$(or $(OUT),out/fuzz)" $(if $(PAGE),--page "$(PAGE)")

# Every call to the system and every array of a run of a tool fails once: make faults [OUT=folder]
faults: install
	$(PY) tests/fuzz/faults.py --state "$(or $(OUT),out/fuzz)/state.jsonl"

# Rules of the naive decoder that no vector holds, an hour or more (a part: tools/proof/mutants.py --only 7.6, a sample: --sample 400): make mutants [STATE=file.jsonl] [PAGE=docs/reports/mutants.md]
mutants: install
	$(PY) tools/proof/mutants.py --state "$(or $(STATE),out/mutants.jsonl)" $(if $(PAGE),--page "$(PAGE)")

# Branches of all that a decode imports, the JIT off, and those that nothing takes: make coverage [PART="name ..."] [OUT=folder] [PAGE=docs/reports/coverage.md]
coverage: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	$(PY) tools/proof/coverage_table.py $(foreach p,$(PART),--part $(p)) --out "$(or $(OUT),out/coverage)" $(if $(PAGE),--page "$(PAGE)")

# The three targets below rewrite committed files; nothing else does.
vectors: install
	$(PY) -m conformance.make --write

spec-tables: install
	$(PY) -m conformance.make.spec_tables

# Streams that every later release decodes to the same values: new vectors join; ANEW=1 begins again, while the format has version 0
promise: install
	$(PY) -m conformance.make.promise $(if $(ANEW),--anew,--add)

install: $(STAMP)

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

clean:
	@if [ "$(VENV)" = .venv ]; then rm -rf .venv; else echo "$(VENV) is yours: left alone" >&2; fi
	rm -rf build dist out .pytest_cache .hypothesis .ruff_cache .mypy_cache .benchmarks texfcodec.egg-info
	find texfcodec tests conformance bench proof release tools -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

# All that is published of the last commit, built twice and the same both times; needs npm, and pip's index: make release [OUT=folder]
# [NPM=no]. Then, for every Python at hand: python tools/release/try_wheel.py out/release/texfcodec-*.whl python3.12 ...
release: install
	"$(PY)" -m pip install --quiet --disable-pip-version-check --editable ".[release]"
	$(PY) -m tools.release.make_release --out "$(or $(OUT),out/release)" $(if $(filter no,$(NPM)),--without-npm)
