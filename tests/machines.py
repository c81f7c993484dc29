"""Machines that compile the hosts of tests/c, and run FMUs in them: binaries, or C sources."""

import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple

import fmpy
import pytest
from fmpy.model_description import ModelDescription, ModelVariable

import needs
from native import SECONDS, SOURCES
from pendulum_fmus.project import FMUS

CROSS = FMUS.parent / "cross"
"""Folder to which `make cross` writes FMUs for other platforms."""

HEADERS = Path(fmpy.__file__).parent / "c-code"
"""Folder with the headers of the standard."""

# Results are compared bit by bit, so the compiler must not fuse multiplications and additions.
OPTIONS = f"""-std=c99 -D_POSIX_C_SOURCE=200809L -Wall -Wextra -Werror -g -ffp-contract=off
-I{HEADERS}""".split()


class Fmu(NamedTuple):
    """An FMU for a host: the path of its binary, or its name if it is linked into the host."""

    library: str
    guid: str
    variables: dict[str, ModelVariable]


@dataclass(frozen=True)
class Machine:
    """A machine: how to compile hosts for it and run them on it, with the binaries of FMUs."""

    name: str
    tools: tuple[needs.Tool, ...] = ()
    compiler: tuple[str, ...] = ("cc",)
    emulator: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ("-ldl", "-lm")
    fmus: Path = FMUS
    platforms: tuple[str, str] = ("linux64", "x86_64-linux")
    """Folders of its binaries in these FMUs, in FMI 2.0 and 3.0."""
    byte_order: str = "<"
    """Whether the least significant byte is the first (<) or the last (>), as NumPy names it."""
    versions: tuple[str, ...] = ("2", "3")
    """The versions of FMI that the tests run on it."""
    export_options: str = ""
    """Options of `cargo fmu export` for FMUs that it runs."""

    def host(self, name: str, files: Sequence[Path], folder: Path) -> tuple[Path, list[Fmu]]:
        """Compile a host, such as `loop2` for FMI 2.0, once in a folder; return it and the FMUs."""
        program = folder / f"{name}.exe"
        if not program.exists():
            self.compile(name, program)
        return program, [self.unpack(file, folder) for file in files]

    def compile(self, name: str, program: Path, *more: str | Path) -> None:
        """Compile a host, with more options or files."""
        options = [*OPTIONS, f"-DFMI={name[-1]}", "-o", program, SOURCES / f"{name[:-1]}.c"]
        compile_files([[*self.compiler, *options, *more, *self.libraries]])

    def unpack(self, file: Path, folder: Path) -> Fmu:
        """Unpack the binary of an FMU."""
        description = described_by(file)
        platform = self.platforms[description.fmiVersion == "3.0"]
        extension = "dll" if "win" in platform else "so"
        name = f"binaries/{platform}/{description.coSimulation.modelIdentifier}.{extension}"
        with zipfile.ZipFile(file) as package:
            binary = Path(package.extract(name, folder / file.stem))
        return Fmu(self.path(binary), description.guid, variables(description))

    def run(self, program: Path, *arguments: str) -> str:
        """Run a program that must succeed without warnings; return its output."""
        done = call(*self.emulator, program, *arguments)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return done.stdout

    def path(self, file: Path) -> str:
        """Return the path of a file as its programs see it: Wine has all files on drive Z."""
        return str(PureWindowsPath(f"Z:{file}")) if self.emulator == ("wine",) else str(file)

    @contextmanager
    def started(self, folder: Path) -> Iterator[None]:
        """Start it; Wine needs a folder."""
        for tool in self.tools:
            tool.require()
        if self.emulator != ("wine",):
            yield
            return
        with wine(folder):
            yield


@dataclass(frozen=True)
class SourceMachine(Machine):
    """A machine that compiles the C sources of FMUs, and links them into its hosts."""

    options: tuple[str, ...] = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
    """Options with which the sources compile."""

    def host(
        self, name: str, files: Sequence[Path], folder: Path, *definitions: str
    ) -> tuple[Path, list[Fmu]]:
        """Compile a host and the FMUs in it once in a folder; return them.

        `definitions` are more macros of the host.
        """
        program = folder / f"{'-'.join([name, *(file.stem for file in files)])}.exe"
        descriptions = [described_by(file) for file in files]
        fmus = [Fmu(f.stem, d.guid, variables(d)) for f, d in zip(files, descriptions, strict=True)]
        if not program.exists():
            objects = self.objects(files, folder)
            rows = (f"LINK({fmu.library}, {f})\n" for fmu in fmus for f in functions(name[-1]))
            linked = program.with_suffix(".h")
            linked.write_text("".join(rows))
            self.compile(name, program, f'-DLINKED="{linked}"', *definitions, *objects)
        return program, fmus

    def objects(self, files: Sequence[Path], folder: Path, *definitions: str) -> list[Path]:
        """Compile the sources of FMUs once in a folder; file names are prefixes of functions.

        `definitions` are more macros.
        """
        objects, commands = [], []
        for file in files:
            place, version = folder / file.stem, described_by(file).fmiVersion[0]
            prefix = f"-DFMI{version}_FUNCTION_PREFIX={file.stem}_"
            for source in unpack_sources(file, place):
                output = source.with_suffix(".o")
                objects.append(output)
                if not output.exists():
                    options = [*self.options, prefix, *definitions]
                    commands.append([*self.compiler, *options, "-c", source, "-o", output])
        compile_files(commands)
        return objects


def compile_files(commands: Sequence[Sequence[str | Path]]) -> None:
    """Run compilers, two at a time, which must be silent."""
    with ThreadPoolExecutor(2) as pool:
        for done in pool.map(lambda command: call(*command), commands):
            assert (done.returncode, done.stderr) == (0, ""), f"{done.args}\n{done.stderr}"


def unpack_sources(file: Path, folder: Path) -> list[Path]:
    """Unpack the sources of an FMU; return those that its build description lists."""
    with zipfile.ZipFile(file) as package:
        names = [name for name in package.namelist() if name.startswith("sources/")]
        package.extractall(folder, names)
    (configuration,) = described_by(file).buildConfigurations
    (files,) = configuration.sourceFileSets
    return [folder / "sources" / name for name in files.sourceFiles]


def described_by(file: Path) -> ModelDescription:
    """Read the model description of an FMU, which must exist."""
    if not file.exists():
        pytest.fail(f"{file} is missing: `make cross` exports it", pytrace=False)
    return fmpy.read_model_description(file)


def variables(description: ModelDescription) -> dict[str, ModelVariable]:
    """Return the variables by name."""
    return {variable.name: variable for variable in description.modelVariables}


def functions(version: str) -> list[str]:
    """Return the functions of a version of FMI: 2 or 3."""
    header = (HEADERS / f"fmi{version}Functions.h").read_text()
    return re.findall(r"FullName\((fmi\w+)\)", header)


def call(*command: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command."""
    options = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    return subprocess.run(command, timeout=SECONDS, **options)


@contextmanager
def wine(folder: Path) -> Iterator[None]:
    """Create a separate Wine prefix, and stop its processes at the end."""
    with pytest.MonkeyPatch.context() as environment:
        for name, value in {
            "WINEPREFIX": str(folder / "wine"),
            "WINEARCH": "win64",
            "WINEDEBUG": "-all",
            "WINEDLLOVERRIDES": "mscoree,mshtml,winemenubuilder.exe=",  # nothing to install
            "DISPLAY": "",
        }.items():
            environment.setenv(name, value)
        try:
            call("wine", "wineboot", "--init").check_returncode()
            yield
        finally:
            call("wineserver", "--kill")  # fails if it has already exited


# --- with the binaries of FMUs --------------------------------------------------------------------

NATIVE = Machine("native")

MEMORY_CHECK = (
    "valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full",
    "--errors-for-leak-kinds=definite,indirect",
)  # fmt: skip

VALGRIND = Machine("valgrind", (needs.VALGRIND,), emulator=MEMORY_CHECK)

# Wine 8.0 lacks bcryptprimitives.dll, which seeds Rust's HashMap; the FMUs do not use one.
WINDOWS = Machine(
    "windows",
    (needs.MINGW, needs.WINE),
    compiler=("x86_64-w64-mingw32-gcc",),
    emulator=("wine",),
    libraries=(),
    fmus=CROSS,
    platforms=("win64", "x86_64-windows"),
    export_options="--target x86_64-pc-windows-gnu",
)

ARM = Machine(
    "arm",
    (needs.QEMU,),
    compiler=(sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-gnu.2.17"),
    emulator=("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    fmus=CROSS / "aarch64",
    platforms=("linux64", "aarch64-linux"),
    export_options="--target aarch64-unknown-linux-gnu.2.17",
)

# --- with their C sources -------------------------------------------------------------------------

EXPORTED = FMUS.parent / "sources"
"""Folder of the FMUs with C sources."""

SANITIZE = "-g -fsanitize=address,undefined -fno-sanitize-recover=all"


def _sources(
    name: str, command: str, *tools: needs.Tool, emulator: str = "", **fields: Any
) -> SourceMachine:
    return SourceMachine(
        f"sources-{name}",
        tools,
        compiler=tuple(command.split()),
        emulator=tuple(emulator.split()),
        libraries=("-lm",),
        fmus=EXPORTED,
        export_options="--sources",
        **fields,
    )


FMI_2, FMI_3 = ("2",), ("3",)

# The lower levels of optimization compile in a fraction of the time. On ARM, the higher ones fuse
# multiplications and additions unless the sources prevent it.
IN_C = [_sources("cc-O2", "cc -O2", versions=FMI_2), _sources("cc-O0", "cc -O0")]
"""With the compiler that the README names."""

IN_C_OPTIONAL = [_sources("tcc", "tcc", needs.TCC)]

IN_C_VALGRIND = _sources(
    "valgrind", "cc -O1 -g", needs.VALGRIND, emulator=" ".join(MEMORY_CHECK), versions=FMI_2
)

IN_C_ELSEWHERE = [
    _sources("clang-O2", "clang -O2", needs.CLANG, versions=FMI_2),
    # Without SSE2, a 32-bit processor computes with more bits.
    _sources(
        "i686",
        "i686-linux-gnu-gcc -O0 -static -msse2 -mfpmath=sse",
        needs.I686,
        versions=FMI_2,
    ),
    _sources(
        "arm",
        "arm-linux-gnueabihf-gcc -O2 -static -mfpu=neon-vfpv4",
        needs.ARM32,
        emulator="qemu-arm",
        versions=FMI_2,
    ),
    _sources(
        "s390x",
        "s390x-linux-gnu-gcc -O0 -static",
        needs.S390X,
        emulator="qemu-s390x",
        byte_order=">",
    ),
    # GCC's, which take long; like Clang, their libraries may be missing.
    _sources("sanitizers", f"cc -O0 {SANITIZE}", needs.CLANG, versions=FMI_3),
    _sources("gcc-O3", "gcc -O3", needs.CLANG),
    _sources("clang-O0", "clang -O0", needs.CLANG),
    _sources("clang-O3", "clang -O3", needs.CLANG),
    _sources("clang-sanitizers", f"clang -O1 {SANITIZE}", needs.CLANG),
]
