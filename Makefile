# The project's main jobs, on a machine with a Rust toolchain, Python 3.11 and a C compiler.
# What else they need they install into target/venv, pinned by tests/requirements.txt.

PYTHON ?= python3
VENV := target/venv
RUN := $(VENV)/bin/python
INSTALL := $(RUN) -m pip install --quiet --disable-pip-version-check

# cargo-zigbuild, and the Python that has zig.
WITH_ZIG := PATH="$(abspath $(VENV)/bin):$$PATH"
RUST_SOURCES := lib/rustlib/src/rust/library

SECONDS ?= 60
REPORT ?= target/report
BUILT ?= target/built
MERGED ?= target/merged

.PHONY: demo report test lint fmus master ssp libclang libtbb bench portable cross cross-tools merged \
	valgrind elsewhere fuzz clean
.DEFAULT_GOAL := demo

## demo: export the FMUs, couple them by FMPy, print Table 1, draw the plots in target/report
demo: fmus
	$(RUN) -m report --only paper

## report: all figures of the paper, and what goes beyond it, as a page in REPORT=target/report
report: fmus master
	$(RUN) -m report --out $(REPORT)

## test: every test, of the Rust crates and through the FMUs
test: lint fmus master portable libtbb
	cargo test --locked --workspace
	cargo test --locked --package fmu-description --all-features
	$(RUN) -m pytest

## lint: formatting, lints and documentation, without a warning
lint: libclang
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets --all-features -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --all-features
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .

## fmus: write the FMUs to target/fmu
fmus: $(VENV)/.installed
	cargo fmu export

## master: build the native master, which `cargo fmu simulate` and others then use at once
master: libclang
	cargo build --locked --quiet --profile native --package cargo-fmu

## ssp: write the loops of the paper as SSP packages for other tools to target/fmu
ssp: fmus master
	cargo fmu ssp examples/ssp/*.toml

## libclang: install what the native master needs to be built to target/libclang
libclang: target/libclang/.installed

# Where .cargo/config.toml looks for it. The package has no C headers; the C compiler has.
target/libclang/.installed: $(VENV)/.installed
	mkdir -p $(@D)
	ln -sf $$($(RUN) -c 'import clang; print(*clang.__path__)')/native/libclang.* $(@D)
	ln -sfn $$($(CC) -print-file-name=include) $(@D)/include
	touch $@

## libtbb: install what Ecos needs, an importer of SSP packages that the tests run
libtbb: $(VENV)/.installed
	$(RUN) -c "import ecospy" 2>/dev/null || { apt-get update && apt-get install --yes libtbb12; }

## portable: write FMUs that load with glibc 2.17 and newer to target/portable
portable: $(VENV)/.portable
	$(WITH_ZIG) cargo fmu export --portable --out target/portable

## cross: write FMUs for Linux, Windows and macOS to target/cross, for Linux on ARM to target/cross/aarch64
cross: cross-tools
	$(WITH_ZIG) cargo fmu export --target x86_64-unknown-linux-gnu.2.17 \
		--target x86_64-pc-windows-gnu --target universal2-apple-darwin --out target/cross
	$(WITH_ZIG) cargo fmu export --target aarch64-unknown-linux-gnu.2.17 --out target/cross/aarch64

## cross-tools: install a linker for Windows, and the standard library of Rust for other systems or its sources
cross-tools: $(VENV)/.portable
	command -v x86_64-w64-mingw32-gcc >/dev/null \
		|| { apt-get update && apt-get install --yes gcc-mingw-w64-x86-64; }
	test -d "$$(rustc --print sysroot)/$(RUST_SOURCES)" || test -d /usr/$(RUST_SOURCES) \
		|| rustup target add x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-pc-windows-gnu \
			x86_64-apple-darwin aarch64-apple-darwin \
		|| { apt-get update && apt-get install --yes rustc-web cargo-web rust-web-src; }

## merged: join the FMUs that several machines wrote, target/built/*/*.fmu, to target/merged, with checksums
merged:
	rm -rf $(MERGED) && mkdir -p $(MERGED)
	for fmu in $(sort $(notdir $(wildcard $(BUILT)/*/*.fmu))); do \
		cargo fmu merge $(BUILT)/*/$$fmu -o $(MERGED)/$$fmu || exit; done
	cd $(MERGED) && sha256sum *.fmu > SHA256SUMS

## valgrind: the hosts in C under valgrind, which must find nothing
valgrind: fmus
	command -v valgrind >/dev/null || { apt-get update && apt-get install --yes valgrind; }
	$(RUN) -m pytest -m valgrind tests/test_hosts.py

## elsewhere: the binaries for other platforms; the hosts in C on those that Wine and qemu emulate
elsewhere: fmus cross
	command -v wine >/dev/null || { apt-get update && apt-get install --yes wine wine64; }
	command -v qemu-aarch64 >/dev/null && test -d /usr/aarch64-linux-gnu/lib \
		|| { apt-get update && apt-get install --yes qemu-user libc6-arm64-cross; }
	$(WITH_ZIG) $(RUN) -m pytest -m elsewhere tests/test_cross.py tests/test_hosts.py

## bench: what the FMUs and the native master cost, as a table and plots in target/bench
bench: fmus master $(VENV)/.bench
	$(RUN) bench/run.py

## fuzz: damaged archives and XML, random calls, forged states, each for about SECONDS=60
fuzz: fmus
	FUZZ_SECONDS=$(SECONDS) cargo run --locked --profile fuzz --package fuzz
	FMU_SEQUENCES=$$(($(SECONDS) * 60)) FMU_MUTATIONS=$$(($(SECONDS) * 50)) \
		$(RUN) -m pytest tests/test_call_sequences.py tests/test_c_fmu_state.py

$(VENV)/.portable: tests/requirements-portable.txt $(VENV)/.installed
	$(INSTALL) --requirement $<
	touch $@

$(VENV)/.bench: bench/requirements.txt $(VENV)/.installed
	$(INSTALL) --requirement $<
	touch $@

$(VENV)/.installed: tests/requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --requirement $<
	touch $@

clean:
	rm -rf target
