"""Build the FMU of pid.c: `python build.py [FOLDER]` writes CPid.fmu to FOLDER or target/own-fmu.

It needs a C compiler, `cc` or $CC, and only Python's standard library.
"""

import os
import platform
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
MODEL = "CPid"

# -ffp-contract=off: no fused multiply-add, as in Rust.
FLAGS = ["-O2", "-ffp-contract=off", "-shared", "-fPIC"]

PLATFORMS = {
    "Linux": ("linux", ".so"),
    "Darwin": ("darwin", ".dylib"),
    "Windows": ("win", ".dll"),
}


def build(folder: Path) -> Path:
    """Write the FMU into a folder; return its path."""
    system, suffix = PLATFORMS[platform.system()]
    bits = 64 if sys.maxsize > 2**32 else 32
    folder.mkdir(parents=True, exist_ok=True)
    # In the same folder, so that the finished FMU can be renamed atomically.
    with TemporaryDirectory(dir=folder) as temporary:
        library = Path(temporary) / f"{MODEL}{suffix}"
        compiler = shlex.split(os.environ.get("CC", "cc"))
        subprocess.run([*compiler, *FLAGS, HERE / "pid.c", "-o", library], check=True)
        package = Path(temporary) / f"{MODEL}.fmu"
        with zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(HERE / "modelDescription.xml", "modelDescription.xml")
            archive.write(library, f"binaries/{system}{bits}/{library.name}")
        return package.replace(folder / package.name)


if __name__ == "__main__":
    default = HERE.parent.parent / "target" / "own-fmu"
    print(build(Path(sys.argv[1]) if len(sys.argv) > 1 else default))
