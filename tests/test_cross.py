"""The FMUs of `make cross` for Linux, Windows and macOS, checked by their headers.

No binary of another system is run here. The macOS binaries have never been run.
"""

import os
import re
import shutil
import struct
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import fmpy
import pytest

import native
from machines import CROSS
from native import run
from needs import LIEF
from pendulum_fmus.project import PROGRAM, ROOT
from test_package import FMI2_FUNCTIONS, FMI3_FUNCTIONS, MODELS

ARM = CROSS / "aarch64"

BINARIES = {
    CROSS: {"linux64": "so", "win64": "dll", "darwin64": "dylib", "aarch64-darwin": "dylib"},
    ARM: {"linux64": "so", "aarch64-linux": "so"},
}
"""By folder of FMUs: the platforms, with their names in FMI 2.0, and the ending of the binaries."""

IN_FMI_3 = {"linux64": "x86_64-linux", "win64": "x86_64-windows", "darwin64": "x86_64-darwin"}
"""Names of platforms in FMI 3.0, where they differ."""

TARGETS = {
    CROSS: "x86_64-unknown-linux-gnu.2.17 x86_64-pc-windows-gnu universal2-apple-darwin",
    ARM: "aarch64-unknown-linux-gnu.2.17",
}

GLIBC = (2, 17)
GLIBC_LIBRARIES = {
    "libc.so.6", "libm.so.6", "libdl.so.2", "libpthread.so.0", "ld-linux-x86-64.so.2",
    "ld-linux-aarch64.so.1",
}  # fmt: skip

# Every Windows version that Rust supports has these in its system folder: the kernel's interface,
# its API sets, and the system C library, but not what MinGW adds, such as libgcc_s_seh-1.dll.
WINDOWS_LIBRARIES = {"kernel32.dll", "ntdll.dll", "msvcrt.dll"}
WINDOWS_API_SET = re.compile(r"api-ms-win-core-[a-z0-9-]+\.dll")

MACOS_LIBRARY = "/usr/lib/libSystem.B.dylib"
# Exported by zig's linker, and not hidden by the standard library of a toolchain. They do no harm,
# since macOS looks up a symbol in the library in which it was found at link time.
MACOS_EXPORTS = re.compile(r"__mh_dylib_header|___dso_handle|_rust_eh_personality|__R.*EMPTY_PANIC")

# Magic numbers of CS_SuperBlob and CS_CodeDirectory in Apple's headers
SUPER_BLOB, CODE_DIRECTORY, AD_HOC, SHA256 = 0xFADE0CC0, 0xFADE0C02, 0x2, 2

if LIEF.there():
    import lief

    lief.logging.disable()  # it warns about every table that a stripped library lacks

pytestmark = [pytest.mark.elsewhere, pytest.mark.usefixtures("reader")]

each_model = pytest.mark.parametrize("model", [*MODELS, "PidRbf_fmi3", "Pendulum_fmi3"])
each_folder = pytest.mark.parametrize("folder", BINARIES, ids=["cross", "aarch64"])


@pytest.fixture(scope="module")
def reader() -> None:
    """Fail without lief, which reads the headers."""
    LIEF.require()


def fmu(model: str, folder: Path = CROSS) -> Path:
    """Return the path of an FMU."""
    file = folder / f"{model}.fmu"
    assert file.exists(), f"{file} is missing: run `make cross`"
    return file


def binaries(model: str, folder: Path = CROSS) -> dict[str, str]:
    """Return the name of the binary of each platform in an FMU."""
    name, found = model.removesuffix("_fmi3"), {}
    for platform, extension in BINARIES[folder].items():
        place = platform
        if name != model:
            place = "aarch64-linux" if folder == ARM else IN_FMI_3.get(platform, platform)
        found[platform] = f"binaries/{place}/{name}.{extension}"
    return found


def read(model: str, platform: str, folder: Path = CROSS) -> bytes:
    """Return the binary of a platform."""
    return native.read(fmu(model, folder))[binaries(model, folder)[platform]]


def functions(model: str) -> set[str]:
    """Return the functions that a binary exports."""
    return FMI3_FUNCTIONS if model.endswith("_fmi3") else FMI2_FUNCTIONS


@pytest.fixture
def macos(model: str):
    """Return the universal library for macOS."""
    return lief.MachO.parse(list(read(model, "darwin64")))


# --- the packages ---------------------------------------------------------------------------------


@each_model
@each_folder
def test_a_binary_for_each_platform_is_added_to_the_plain_fmu(fmus, model, folder):
    merged, plain = native.read(fmu(model, folder)), native.read(fmus / f"{model}.fmu")
    names = {name for name in merged if name.startswith("binaries/")}
    assert names == set(binaries(model, folder).values())
    assert merged["modelDescription.xml"] == plain["modelDescription.xml"]
    contents = {platform: merged[name] for platform, name in binaries(model, folder).items()}
    guid = fmpy.read_model_description(fmu(model, folder)).guid.encode()
    rustc = ["rustc", "--print", "sysroot"]
    sysroot = subprocess.run(rustc, capture_output=True, text=True, check=True).stdout.strip()
    paths = [ROOT, Path.home(), sysroot, "/usr/src", "/usr/lib/rustlib", "/tmp"]
    paths += [os.environ[name] for name in ("CARGO_HOME", "RUSTUP_HOME") if name in os.environ]
    for platform, content in contents.items():
        assert guid in content
        for path in paths:  # of this machine
            assert os.fsencode(path) + b"/" not in content, f"{platform} contains {path}"
    first, second = (
        ("linux64", "aarch64-linux") if folder == ARM else ("darwin64", "aarch64-darwin")
    )
    assert contents[first] == contents[second]


@each_folder
def test_a_build_in_another_folder_gives_the_same_bytes(folder, monkeypatch):
    copy = ROOT / "target" / "reproduced" / "project"
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("target", ".git", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=ignored)
    (copy / "target").symlink_to(copy.parent)
    options = [f"--target={target}" for target in TARGETS[folder].split()]
    tools = str(Path(sys.executable).parent)
    monkeypatch.setenv("PATH", os.pathsep.join([tools, os.environ["PATH"]]))
    # It takes longer than other runs of the program.
    subprocess.run([PROGRAM, "export", "Source", *options, "--out", copy], cwd=copy, check=True)
    ours, theirs = native.read(copy / "Source.fmu"), native.read(fmu("Source", folder))
    for name in binaries("Source", folder).values():
        assert ours[name] == theirs[name], name


# --- Linux ----------------------------------------------------------------------------------------


@each_model
@each_folder
def test_linux_binary_is_for_its_processor_and_an_old_glibc(model, folder):
    library = lief.ELF.parse(list(read(model, "linux64", folder)))
    processor = lief.ELF.ARCH.AARCH64 if folder == ARM else lief.ELF.ARCH.X86_64
    assert library.header.machine_type == processor
    assert set(library.libraries) <= GLIBC_LIBRARIES
    versions = [
        requirement.name.removeprefix("GLIBC_")
        for needed in library.symbols_version_requirement
        for requirement in needed.get_auxiliary_symbols()
    ]
    assert versions
    assert max(tuple(map(int, version.split("."))) for version in versions) <= GLIBC
    assert {symbol.name for symbol in library.exported_symbols} == functions(model)


# --- Windows --------------------------------------------------------------------------------------


@each_model
def test_windows_binary_has_the_functions_of_the_standard_and_needs_only_system_libraries(model):
    windows = lief.PE.parse(list(read(model, "win64")))
    assert windows.header.machine == lief.PE.Header.MACHINE_TYPES.AMD64
    assert windows.header.has_characteristic(lief.PE.Header.CHARACTERISTICS.DLL)
    assert {entry.name for entry in windows.get_export().entries} == functions(model)
    names = {library.name.lower() for library in windows.imports}
    assert names
    assert {name for name in names if not WINDOWS_API_SET.fullmatch(name)} <= WINDOWS_LIBRARIES


# --- macOS ----------------------------------------------------------------------------------------


@each_model
def test_macos_binary_is_for_both_processors_and_needs_only_the_system_library(macos, model):
    processors = [part.header.cpu_type for part in macos]
    assert processors == [lief.MachO.Header.CPU_TYPE.X86_64, lief.MachO.Header.CPU_TYPE.ARM64]
    for part in macos:
        assert part.header.file_type == lief.MachO.Header.FILE_TYPE.DYLIB
        assert part.build_version.platform == lief.MachO.BuildVersion.PLATFORMS.MACOS
        assert part.build_version.minos == [11, 0, 0]
        (own, *needed) = part.libraries
        assert own.command == lief.MachO.LoadCommand.TYPE.ID_DYLIB
        assert re.fullmatch(r"@rpath/fmu_\w+\.dylib", own.name)
        assert [library.name for library in needed] == [MACOS_LIBRARY]
        names = {entry.symbol.name for entry in part.dyld_info.exports if entry.symbol}
        expected = {f"_{name}" for name in functions(model)}
        assert names >= expected
        assert all(MACOS_EXPORTS.fullmatch(name) for name in names - expected)


@each_model
def test_macos_binary_for_arm_has_a_valid_signature(macos, model):
    arm = macos.at(1)
    signature = bytes(arm.code_signature.content)
    magic, _, _, _, start = struct.unpack_from(">5I", signature)
    assert magic == SUPER_BLOB
    magic, _, _, flags, hashes, _, _, pages, length, size, kind, _, page = struct.unpack_from(
        ">9I4B", signature, start
    )
    assert (magic, kind) == (CODE_DIRECTORY, SHA256)
    assert flags & AD_HOC
    # A library modified after signing, such as by stripping, has different hashes.
    assert length == arm.code_signature.data_offset
    code = read(model, "darwin64")[arm.fat_offset :][:length]
    expected = [sha256(code[i : i + (1 << page)]).digest() for i in range(0, length, 1 << page)]
    found = signature[start + hashes :][: pages * size]
    assert found == b"".join(expected)


# --- the commands ---------------------------------------------------------------------------------


def test_validate_finds_no_problem_and_runs_no_binary_of_another_processor():
    result = run("validate", *(fmu(model) for model in MODELS))
    assert result.returncode == 0, result.stdout
    assert "warning:" not in result.stdout
    result = run("validate", fmu("Pid", ARM))
    assert result.returncode == 0, result.stdout
    assert "another processor" in result.stdout
