# Each target does its own set-up: a virtual environment in .venv with the pinned versions, nothing global.
# Needs python3 (3.11 or later) with venv, and make. `make` alone lists the targets.

PYTHON ?= python3
# Where a shell sets it, each process that a test starts compiles the tree anew: a third of what its start costs.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv
BIN := $(VENV)/bin
# What is installed: what the product needs (242 MB), and with it what its development needs (889 MB).
DEMO := $(VENV)/demo
STAMP := $(VENV)/installed
# Tools that the product's environment shall not have: fuzzer, mutation testing, bill of materials, the maker of constraints.
TOOLS := .venv-tools/bin

.PHONY: help install demo demo-fleet demo-desk test test-unit test-system nightly test-socketcan test-robot metrics-rules readers clients drive-clients zenohd test-zenohd store-server test-store test-image test-cluster lint types architecture reach generate pictures bench bench-short bench-recorder bench-review mutation fuzz constraints sbom deb release clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "%-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(DEMO)  ## chassis, gateway, recorder and two operators, for half a minute
	$(BIN)/cruiser demo --seconds 30 --out demo-log

demo-fleet: $(DEMO)  ## a fleet with keys: let in, driven, its operator locked out; each command as it runs
	rm -rf demo-fleet
	PATH="$(abspath $(BIN)):$$PATH" docs/examples/fleet.sh

demo-desk: $(DEMO)  ## a virtual fleet and the desk, in your browser, until Ctrl-C
	$(BIN)/cruiser demo --desk --out demo-desk

# Tests that only reckon take the processor time that the tests of processes leave over, so that they hold up no robot.
test: test-packages $(STAMP)  ## the whole test suite; what it lacks of Debian's packages it installs, or names
	@$(BIN)/python -m tests.support.summary $(MAKE) --jobs 2 --keep-going --output-sync=target test-system test-unit ASIDE=tests/support/aside.sh

.PHONY: test-packages
test-packages:
	@bash -c '. .ci/packages' || true

test-unit: $(STAMP)  ## what needs no process and no socket
	$(ASIDE) $(BIN)/python -m pytest --numprocesses $$(nproc) --dist worksteal --ignore tests/system --timeout 600 tests

# Some have the machine to themselves: a browser that drives at 50 Hz stalls beside others, and the robot stops by its
# deadman, as it should; floods, crowds and demos would make others late. The others wait more than they reckon, so that two
# run for each processor (tests/support/spreading.py hands them out).
ALONE = $(addprefix tests/system/,gateway/test_desk.py gateway/test_desk_contact.py gateway/test_desk_crowd.py gateway/test_desk_logs.py test_floods.py \
	test_readme.py test_fleet_example.py gateway/cli/test_demo.py)
# Chromium without the parts that nobody sees takes two thirds of the processor time; `make nightly` has all of it.
test-system: export TEST_BROWSER ?= $(shell command -v chromium-headless-shell)
test-system: $(STAMP)  ## what starts processes: gateways, recorders, browsers
	$(BIN)/python -m pytest $(ALONE)
	$(BIN)/python -m pytest --numprocesses $$((2 * $$(nproc))) --dist loadfile --no-loadscope-reorder \
		$(addprefix --ignore ,$(ALONE)) tests/system

# By night once more, in the whole of Chromium, and each way to let go of a robot twenty times.
PAGES = tests/nightly/test_desk.py \
	$(addprefix tests/system/,gateway/test_desk.py gateway/test_desk_contact.py gateway/test_desk_logs.py gateway/test_accessibility.py recorder/review/report)
NIGHT = night-long night-rows night-system night-pages night-scenarios night-fuzz drive-clients test-zenohd test-store \
	test-image test-cluster test-robot night-robot
# One after the other; a part that fails keeps no other from running.
nightly:  ## what takes too long for every day: the gate's whole domain, whole matrices, properties thirtyfold, 10,000 random scenarios, the fuzzer, clients of other languages, Zenoh's own router; four hours
	$(MAKE) --keep-going $(NIGHT)

.PHONY: $(filter night-%,$(NIGHT))
night-long night-rows night-system night-pages night-scenarios: $(STAMP)
night-fuzz: .venv-tools/installed
night-long:
	$(BIN)/python -m pytest --numprocesses $$(nproc) --dist worksteal --ignore tests/nightly/test_desk.py tests/nightly
night-rows:
	$(BIN)/python -m pytest --numprocesses $$(nproc) --dist worksteal -m "hypothesis or night" --hypothesis-profile nightly --timeout 600 tests/unit
night-system:
	$(BIN)/python -m pytest -m night --hypothesis-profile nightly tests/system
night-pages:
	$(BIN)/python -m pytest $(PAGES)
night-scenarios:
	$(BIN)/python -m tests.system.scenarios --frozen --jobs $$(nproc)
	$(BIN)/python -m tests.system.scenarios --count 10000 --jobs $$(nproc) --seed 1
night-fuzz:
	$(TOOLS)/python -m tests.fuzz --seconds 1200 --jobs $$(nproc)
night-robot: zenohd
	ROBOT_ZENOHD=$(ZENOHD)/bin/zenohd $(MAKE) test-robot RELEASE=trixie TESTS="tests/robot/test_power_cut.py tests/robot/test_signed.py"

test-socketcan: $(STAMP)  ## the gateway on a real SocketCAN interface; boots user-mode Linux where the kernel has none
	tests/socketcan/run

test-robot: $(STAMP)  ## the package on a Debian that boots in user-mode Linux, a chassis outside: power cuts, faults, upgrades; RELEASE=trixie; root
	$(BIN)/python deploy/deb.py --release $(or $(RELEASE),bookworm) --architecture amd64
	RELEASE=$(or $(RELEASE),bookworm) tests/robot/run $(TESTS)

# Nodes and routers of one version: the crate is of the version of the Python package.
ZENOHD := $(CURDIR)/build/zenohd
ZENOH_VERSION = $(shell sed -n 's/^eclipse-zenoh==\([^ ]*\).*/\1/p' constraints-run.txt)
zenohd:  ## Zenoh's own router, of the version of constraints-run.txt, into build/zenohd; Rust; 15 to 25 minutes
	$(ZENOHD)/bin/zenohd --version 2>/dev/null | grep --quiet --fixed-strings "v$(ZENOH_VERSION) " \
		|| $(CARGO) install --locked --force --root $(ZENOHD) --version $(ZENOH_VERSION) zenohd

test-zenohd: $(STAMP) zenohd  ## the tests of signed mode, once more with Zenoh's own router in the place of ours
	ZENOHD=$(ZENOHD)/bin/zenohd $(BIN)/python -m pytest --hypothesis-profile nightly \
		tests/zenohd tests/system/gateway/zenoh/test_access.py tests/system/test_self_test.py \
		tests/system/test_transport_in_drive.py

# Pinned by the checksum that Go's own database has of it.
S3_SERVER := $(CURDIR)/build/s3/gofakes3
store-server:  ## a server that speaks S3, for tests, into build/s3; Go 1.24; half a minute to five
	@test -x $(S3_SERVER) || GOBIN=$(dir $(S3_SERVER)) go install github.com/johannesboyne/gofakes3/cmd/gofakes3@v1.2.0

test-store: $(STAMP) store-server  ## the upload of logs against that server
	S3_SERVER=$(S3_SERVER) $(BIN)/python -m pytest tests/s3

test-image: .venv-tools/installed  ## compose.yaml, and what the Containerfile says and runs, without an engine; the package index
	$(TOOLS)/python -m pytest tests/container

metrics-rules: $(STAMP)  ## alert rules, dashboard and metrics, as promtool of Debian's prometheus sees them
	tests/promtool/run

readers: $(STAMP)  ## logs as rerun reads them, and the packages of Foxglove and Lichtblick in Chromium; 800 MB of their own; Node.js 20
	@test -x .venv-readers/bin/rerun || { $(PYTHON) -m venv .venv-readers && \
		.venv-readers/bin/python $(PINNED) constraints-readers.txt; }
	cd tests/readers/viewer && $(NPM_INSTALL) && npm run --silent build
	READERS_PYTHON=.venv-readers/bin/python $(BIN)/python -m pytest tests/readers

test-cluster: $(STAMP)  ## export and rerun on a Ray cluster of two nodes on this machine; an environment of 700 MB; ten minutes
	@test -x .venv-ray/bin/ray || { $(PYTHON) -m venv .venv-ray && .venv-ray/bin/python $(PINNED) constraints-ray.txt; }
	.venv-ray/bin/python $(PROJECT)
	RAY_BIN=.venv-ray/bin $(BIN)/python -m pytest tests/cluster

# Their packages are not among the constraints: they are the examples' own, and nothing of the product needs them.
CARGO := CARGO_TARGET_DIR=$(CURDIR)/build/rust cargo
BRIDGE := $(CURDIR)/build/bridge
NPM_INSTALL := npm ci --ignore-scripts --no-audit --no-fund --loglevel error
clients:  ## the proofs of the clients in Rust and TypeScript, by the test vectors; Rust 1.85 and Node.js 20
	$(CARGO) test --quiet --manifest-path docs/examples/rust/proof/Cargo.toml
	cd docs/examples/typescript && $(NPM_INSTALL) && npm test --silent
	# The page of the desk has the same file; it is made by no step of its own.
	cmp docs/examples/typescript/build/proof.js gateway/desk/page/proof.js

drive-clients: $(STAMP) clients  ## these clients drive robots in open and in signed mode; builds Zenoh for ten minutes
	$(CARGO) build --manifest-path docs/examples/rust/Cargo.toml
	test -x $(BRIDGE)/bin/zenoh-bridge-remote-api || $(CARGO) install --locked --root $(BRIDGE) zenoh-bridge-remote-api
	RUST_CLIENT=$(CURDIR)/build/rust/debug/drive BRIDGE=$(BRIDGE)/bin/zenoh-bridge-remote-api \
		$(BIN)/python -m pytest tests/clients

install: $(STAMP)  ## the environment of the development, in .venv

lint: $(STAMP)  ## ruff: format and rules
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)  ## mypy --strict
	$(BIN)/mypy

architecture: $(STAMP)  ## the import contracts of .importlinter
	$(BIN)/lint-imports

reach: $(STAMP)  ## the modules that each process loads at its start
	@$(BIN)/python -m tests.support.reach

generate: $(STAMP)  ## what is generated: JSON Schemas, the layouts of the DBC files, the tables of docs/
	$(BIN)/python -m schemas.json_schema
	$(BIN)/python -m gateway.chassis.cruiser.layout_file
	$(BIN)/python docs/generate.py

pictures: $(STAMP)  ## the pictures of the README, from runs of the demos; needs Chromium
	$(BIN)/python docs/pictures/make.py

bench: $(STAMP)  ## the figures of docs/performance.md, in ten minutes
	$(BIN)/python -m tests.bench

bench-short: $(STAMP)  ## a little of each bench, to see that it runs; its figures say nothing
	$(BIN)/python -m tests.bench --short

bench-review: $(STAMP)  ## of these the review alone, on a log of 1 GB
	$(BIN)/python -m tests.bench review rerun --review-mb 1000 --minutes 10

bench-recorder: $(STAMP)  ## of these the recorder alone, with five minutes of load
	$(BIN)/python -m tests.bench recorder --recorder-rounds 3 --held-s 10 --sustain-s 300

mutation: .venv-tools/installed  ## mutation testing of the command flow and of the proofs; half an hour
	$(TOOLS)/mutmut run --max-children 2
	$(TOOLS)/mutmut results

fuzz: .venv-tools/installed  ## everything that parses what strangers send, SECONDS=60 in all; x86-64 only
	$(TOOLS)/python -m tests.fuzz --seconds $(or $(SECONDS),60)

# What is pinned stays so, unless UPGRADE=--upgrade: then everything moves to the newest that pyproject.toml admits.
COMPILE = $(TOOLS)/uv pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	--custom-compile-command 'make constraints' $(UPGRADE)
constraints: .venv-tools/installed  ## versions and hashes of all packages, anew from pyproject.toml
	$(COMPILE) pyproject.toml --extra dev --group build -o constraints.txt
	$(COMPILE) pyproject.toml --extra desk --extra metrics --extra upload --group build --constraints constraints.txt -o constraints-run.txt
	$(COMPILE) pyproject.toml --extra ray --group build --constraints constraints.txt -o constraints-ray.txt
	$(COMPILE) --group readers --constraints constraints.txt -o constraints-readers.txt
	$(COMPILE) --group tools --constraints constraints.txt -o constraints-tools.txt

sbom: .venv-tools/installed  ## what an installation consists of, as CycloneDX: build/sbom.json
	$(TOOLS)/python deploy/sbom.py

deb: $(STAMP)  ## Debian packages, for Debian 12 and 13 and Ubuntu 24.04, amd64 and arm64: build/deb
	$(BIN)/python deploy/deb.py $(if $(RELEASE),--release $(RELEASE)) $(if $(ARCHITECTURE),--architecture $(ARCHITECTURE))
	$(BIN)/python -m pytest tests/debian

VERSION = $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
release: deb sbom  ## a release into dist: wheel, source, Debian packages, bill of materials, notes, checksums; tried
	rm -rf dist
	$(BIN)/python -m hatchling build --directory dist
	cp build/deb/cruiser-gateway_$(VERSION)-*.deb build/sbom.json dist
	awk '/^## /{on = index($$2, "[$(VERSION)]")} on' CHANGELOG.md > dist/NOTES.md
	cd dist && sha256sum * > SHA256SUMS
	$(BIN)/python -m pytest tests/release

# Only what has the hash that is written down here, and nothing that would have to be built. The project itself has no
# hash: it brings no package along, and what builds it is among those with one.
PIP = -m pip install --quiet --disable-pip-version-check
PINNED = $(PIP) --require-hashes --only-binary :all: --requirement
PROJECT = $(PIP) --no-deps --no-build-isolation --editable .

# Debian and Ubuntu keep ensurepip, which venv needs, in a package of its own: root gets it, others are told.
$(DEMO): pyproject.toml constraints-run.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "needs Python 3.11 or later" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { test "$$(id -u)" = 0 && command -v apt-get >/dev/null \
		&& apt-get update -qq && apt-get install -y -qq --no-install-recommends python3-venv; } \
		|| { echo "python3 has no venv: sudo apt-get install python3-venv" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python $(PINNED) constraints-run.txt
	$(BIN)/python $(PROJECT)
	@touch $@

$(STAMP): $(DEMO) constraints.txt
	$(BIN)/python $(PINNED) constraints.txt
	@touch $@

.venv-tools/installed: $(STAMP) constraints-tools.txt
	@test -x $(TOOLS)/python || $(PYTHON) -m venv .venv-tools
	$(TOOLS)/python $(PINNED) constraints.txt
	$(TOOLS)/python $(PINNED) constraints-tools.txt
	$(TOOLS)/python $(PROJECT)
	@touch $@

clean:  ## remove the environment and what the demos left
	rm -rf $(VENV) build demo-log demo-log-* demo-desk demo-desk-* demo-fleet
