# Each target does its own set-up: a virtual environment in .venv with the pinned versions, nothing global.
# Needs python3 (3.11 or later) with venv, and make. `make` alone lists the targets.

PYTHON ?= python3
# With it set, each process that a test starts compiles the whole tree: a third of the cost of a start.
unexport PYTHONDONTWRITEBYTECODE
VENV := .venv
BIN := $(VENV)/bin
# Markers of what is installed: the product's packages (242 MB), and with them those of its development (889 MB).
DEMO := $(VENV)/demo
STAMP := $(VENV)/installed
# Tools that stay out of the product's environment: fuzzer, mutation testing, bill of materials, uv.
TOOLS := .venv-tools/bin

.PHONY: help install demo demo-fleet demo-desk test test-unit test-system nightly test-socketcan test-robot metrics-rules readers clients drive-clients zenohd test-zenohd store-server test-store test-image test-cluster lint types architecture reach generate pictures bench bench-short bench-recorder bench-review mutation fuzz constraints sbom deb release clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "%-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(DEMO)  ## run chassis, gateway, recorder and two operators for half a minute
	$(BIN)/cruiser demo --seconds 30 --out demo-log

demo-fleet: $(DEMO)  ## enrol and drive a fleet with keys, then revoke its operator; prints each command
	rm -rf demo-fleet
	PATH="$(abspath $(BIN)):$$PATH" docs/examples/fleet.sh

demo-desk: $(DEMO)  ## run a virtual fleet and open the desk in your browser, until Ctrl-C
	$(BIN)/cruiser demo --desk --out demo-desk

# Unit tests take only the processor time that the system tests leave, so that they delay no robot.
test: test-packages $(STAMP)  ## run the whole test suite; installs missing Debian packages, or names them
	@$(BIN)/python -m tests.support.summary $(MAKE) --jobs 2 --keep-going --output-sync=target test-system test-unit ASIDE=tests/support/aside.sh

.PHONY: test-packages
test-packages:
	@bash -c '. .ci/packages' || true

test-unit: $(STAMP)  ## run the tests that need no process and no socket
	$(ASIDE) $(BIN)/python -m pytest --numprocesses $$(nproc) --dist worksteal --ignore tests/system --timeout 600 tests

# These have the machine to themselves: a browser that drives at 50 Hz stalls beside other tests, and the robot stops by its
# deadman, as it should; the desk's questions about logs get only idle processor time; floods and demos delay the others.
# The rest mostly wait, so two run for each processor (tests/support/spreading.py distributes them).
ALONE = $(addprefix tests/system/,gateway/test_desk.py gateway/test_desk_contact.py gateway/test_desk_logs.py test_floods.py \
	test_readme.py gateway/cli/test_demo.py)
# Headless Chromium takes two thirds of the processor time; `make nightly` uses the whole browser.
test-system: export TEST_BROWSER ?= $(shell command -v chromium-headless-shell)
test-system: $(STAMP)  ## run the tests that start gateways, recorders and browsers
	$(BIN)/python -m pytest $(ALONE)
	$(BIN)/python -m pytest --numprocesses $$((2 * $$(nproc))) --dist loadfile --no-loadscope-reorder \
		$(addprefix --ignore ,$(ALONE)) tests/system

# By night again in the whole of Chromium, each way to let go of a robot twenty times.
PAGES = tests/nightly/test_desk.py \
	$(addprefix tests/system/,gateway/test_desk.py gateway/test_desk_contact.py gateway/test_desk_logs.py gateway/test_accessibility.py recorder/review/report)
NIGHT = night-long night-rows night-system night-pages night-scenarios night-fuzz drive-clients test-zenohd test-store \
	test-image test-cluster test-robot night-robot
# One after the other; the rest runs even if a part fails.
nightly:  ## run what takes too long for each change, as listed in CONTRIBUTING.md; four hours
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

test-socketcan: $(STAMP)  ## test the gateway on a SocketCAN interface; boots user-mode Linux if the kernel has none
	tests/socketcan/run

test-robot: $(STAMP)  ## boot the Debian package in user-mode Linux: power cuts, faults, upgrades; RELEASE=trixie; root
	$(BIN)/python deploy/deb.py --release $(or $(RELEASE),bookworm) --architecture amd64
	RELEASE=$(or $(RELEASE),bookworm) tests/robot/run $(TESTS)

# The router's crate has the version of the Python package.
ZENOHD := $(CURDIR)/build/zenohd
ZENOH_VERSION = $(shell sed -n 's/^eclipse-zenoh==\([^ ]*\).*/\1/p' constraints-run.txt)
zenohd:  ## build Zenoh's own router in the version of constraints-run.txt into build/zenohd; Rust; 15 to 25 minutes
	$(ZENOHD)/bin/zenohd --version 2>/dev/null | grep --quiet --fixed-strings "v$(ZENOH_VERSION) " \
		|| $(CARGO) install --locked --force --root $(ZENOHD) --version $(ZENOH_VERSION) zenohd

test-zenohd: $(STAMP) zenohd  ## run the tests of signed mode with Zenoh's own router in place of ours
	ZENOHD=$(ZENOHD)/bin/zenohd $(BIN)/python -m pytest --hypothesis-profile nightly \
		tests/zenohd tests/system/gateway/zenoh/test_access.py tests/system/test_self_test.py \
		tests/system/test_transport_in_drive.py

# Pinned by its checksum in Go's database.
S3_SERVER := $(CURDIR)/build/s3/gofakes3
store-server:  ## build an S3 server for tests into build/s3; Go 1.24; up to five minutes
	@test -x $(S3_SERVER) || GOBIN=$(dir $(S3_SERVER)) go install github.com/johannesboyne/gofakes3/cmd/gofakes3@v1.2.0

test-store: $(STAMP) store-server  ## test the upload of logs with that server
	S3_SERVER=$(S3_SERVER) $(BIN)/python -m pytest tests/s3

test-image: .venv-tools/installed  ## test compose.yaml and the Containerfile's commands without an engine; the package index
	$(TOOLS)/python -m pytest tests/container

metrics-rules: $(STAMP)  ## check alert rules, dashboard and metrics with promtool of Debian's prometheus
	tests/promtool/run

readers: $(STAMP)  ## read logs with rerun, and with Foxglove's and Lichtblick's packages in Chromium; 800 MB; Node.js 20
	@test -x .venv-readers/bin/rerun || { $(PYTHON) -m venv .venv-readers && \
		.venv-readers/bin/python $(PINNED) constraints-readers.txt; }
	cd tests/readers/viewer && $(NPM_INSTALL) && npm run --silent build
	READERS_PYTHON=.venv-readers/bin/python $(BIN)/python -m pytest tests/readers

test-cluster: $(STAMP)  ## test export and rerun on a Ray cluster of two nodes on this machine; 700 MB; ten minutes
	@test -x .venv-ray/bin/ray || { $(PYTHON) -m venv .venv-ray && .venv-ray/bin/python $(PINNED) constraints-ray.txt; }
	.venv-ray/bin/python $(PROJECT)
	RAY_BIN=.venv-ray/bin $(BIN)/python -m pytest tests/cluster

# The examples pin their own packages; the product needs none of them.
CARGO := CARGO_TARGET_DIR=$(CURDIR)/build/rust cargo
BRIDGE := $(CURDIR)/build/bridge
NPM_INSTALL := npm ci --ignore-scripts --no-audit --no-fund --loglevel error
clients:  ## test the proofs of the Rust and TypeScript clients with the test vectors; Rust 1.85, Node.js 20
	$(CARGO) test --quiet --manifest-path docs/examples/rust/proof/Cargo.toml
	cd docs/examples/typescript && $(NPM_INSTALL) && npm test --silent
	# The desk's page has a copy of this file.
	cmp docs/examples/typescript/build/proof.js gateway/desk/page/proof.js

drive-clients: $(STAMP) clients  ## drive robots with these clients in open and signed mode; builds Zenoh for ten minutes
	$(CARGO) build --manifest-path docs/examples/rust/Cargo.toml
	test -x $(BRIDGE)/bin/zenoh-bridge-remote-api || $(CARGO) install --locked --root $(BRIDGE) zenoh-bridge-remote-api
	RUST_CLIENT=$(CURDIR)/build/rust/debug/drive BRIDGE=$(BRIDGE)/bin/zenoh-bridge-remote-api \
		$(BIN)/python -m pytest tests/clients

install: $(STAMP)  ## install the development environment in .venv

lint: $(STAMP)  ## check format and rules with ruff
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)  ## check types with mypy --strict
	$(BIN)/mypy

architecture: $(STAMP)  ## check the import contracts of .importlinter
	$(BIN)/lint-imports

reach: $(STAMP)  ## list the modules that each process loads at its start
	@$(BIN)/python -m tests.support.reach

generate: $(STAMP)  ## generate JSON Schemas, layouts of the DBC files, tables of docs/
	$(BIN)/python -m schemas.json_schema
	$(BIN)/python -m gateway.chassis.cruiser.layout_file
	$(BIN)/python docs/generate.py

pictures: $(STAMP)  ## make the README's pictures from runs of the demos; needs Chromium
	$(BIN)/python docs/pictures/make.py

bench: $(STAMP)  ## measure the figures of docs/performance.md; twelve minutes
	$(BIN)/python -m tests.bench

bench-short: $(STAMP)  ## see that each bench runs; its figures say nothing; three minutes
	$(BIN)/python -m tests.bench --short

bench-review: $(STAMP)  ## measure the review alone, on a log of 1 GB
	$(BIN)/python -m tests.bench review rerun --review-mb 1000 --minutes 10

bench-recorder: $(STAMP)  ## measure the recorder alone, with five minutes of load
	$(BIN)/python -m tests.bench recorder --recorder-rounds 3 --held-s 10 --sustain-s 300

mutation: .venv-tools/installed  ## change the command flow and the proofs line by line, and see whether a test notices; half an hour
	$(TOOLS)/mutmut run --max-children 2
	$(TOOLS)/mutmut results

fuzz: .venv-tools/installed  ## fuzz everything that parses bytes from the network, SECONDS=60 in all; x86-64
	$(TOOLS)/python -m tests.fuzz --seconds $(or $(SECONDS),60)

# Pinned versions stay, unless UPGRADE=--upgrade: then all move to the newest that pyproject.toml admits.
COMPILE = $(TOOLS)/uv pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	--custom-compile-command 'make constraints' $(UPGRADE)
constraints: .venv-tools/installed  ## pin versions and hashes of all packages from pyproject.toml
	$(COMPILE) pyproject.toml --extra dev --group build -o constraints.txt
	$(COMPILE) pyproject.toml --extra desk --extra metrics --extra upload --group build --constraints constraints.txt -o constraints-run.txt
	$(COMPILE) pyproject.toml --extra ray --group build --constraints constraints.txt -o constraints-ray.txt
	$(COMPILE) --group readers --constraints constraints.txt -o constraints-readers.txt
	$(COMPILE) --group tools --constraints constraints.txt -o constraints-tools.txt

sbom: .venv-tools/installed  ## write the bill of materials as CycloneDX into build/sbom.json
	$(TOOLS)/python deploy/sbom.py

deb: $(STAMP)  ## build Debian packages for Debian 12 and 13 and Ubuntu 24.04, amd64 and arm64, into build/deb
	$(BIN)/python deploy/deb.py $(if $(RELEASE),--release $(RELEASE)) $(if $(ARCHITECTURE),--architecture $(ARCHITECTURE))
	$(BIN)/python -m pytest tests/debian

VERSION = $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
release: deb sbom  ## build a release into dist and test it: wheel, source, Debian packages, bill of materials, notes, checksums
	rm -rf dist
	$(BIN)/python -m hatchling build --directory dist
	cp build/deb/cruiser-gateway_$(VERSION)-*.deb build/sbom.json dist
	awk '/^## /{on = index($$2, "[$(VERSION)]")} on' CHANGELOG.md > dist/NOTES.md
	cd dist && sha256sum * > SHA256SUMS
	$(BIN)/python -m pytest tests/release

# Installs only wheels with a pinned hash. The project itself has no hash; it brings no package along, and its build
# backend is pinned.
PIP = -m pip install --quiet --disable-pip-version-check
PINNED = $(PIP) --require-hashes --only-binary :all: --requirement
PROJECT = $(PIP) --no-deps --no-build-isolation --editable .

# Debian and Ubuntu ship ensurepip, which venv needs, in a package of its own: root installs it, others get the command.
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

clean:  ## remove the environment and the demos' output
	rm -rf $(VENV) build demo-log demo-log-* demo-desk demo-desk-* demo-fleet
