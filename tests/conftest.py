"""Fixtures: the exported FMUs, instances of them, and the runs of Table 1."""

import os
import pickle
import shlex
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from filelock import FileLock

from needs import (  # noqa: F401, hooks
    pytest_collection_modifyitems,
    pytest_runtest_setup,
    pytest_terminal_summary,
)
from pendulum_fmus import table1
from pendulum_fmus.loop import Columns, Loop, workers
from pendulum_fmus.master import Component
from pendulum_fmus.project import FMUS, PROGRAM, ROOT, SENSOR

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FLAGS = """--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
--disable-component-update --disable-sync""".split()
"""Command line of Chromium."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return one process more than there are cores, since tests often wait for a lock or a call."""
    return (os.cpu_count() or 1) + 1


@pytest.fixture(scope="session")
def once(
    tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config
) -> Callable[..., Path]:
    """Return a function that makes a folder once for all processes that run tests.

    The environment variable ONCE can name a folder that several runs of pytest share.
    """
    base = tmp_path_factory.getbasetemp()
    # In a process of pytest-xdist, which some workflows do not install.
    base = base.parent if hasattr(pytestconfig, "workerinput") else base
    base = Path(os.environ.get("ONCE", base))

    def make(name: str, write: Callable[[Path], object]) -> Path:
        folder, finished = base / name, base / f"{name}.finished"
        with FileLock(base / f"{name}.lock"):
            if not finished.exists():
                folder.mkdir(exist_ok=True)
                write(folder)
                finished.touch()
        return folder

    return make


@pytest.fixture(scope="session")
def export(once: Callable[..., Path]) -> Callable[..., Path]:
    """Return a function that exports FMUs once with the current program to a folder."""

    def call(*command: str) -> None:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            message = f"{shlex.join(command)} failed:\n{done.stdout}{done.stderr}"
            pytest.fail(message, pytrace=False)

    def run(folder: Path, *options: str) -> Path:
        command = [str(PROGRAM), "export", *options, "--out", str(folder)]
        once("program", lambda _: call("make", "program"))
        once(f"export-{zlib.crc32(shlex.join(command).encode())}", lambda _: call(*command))
        return folder

    return run


@pytest.fixture(scope="session")
def fmus(export: Callable[..., Path]) -> Path:
    """Export the FMUs from the current sources; return their folder.

    The environment variable FMUS can name a folder of FMUs to test instead.
    """
    if given := os.environ.get("FMUS"):
        return ROOT / given
    # The default output folder depends on cargo's target folder.
    return export(FMUS, "--fmi", "2.0,3.0")


@pytest.fixture(scope="session")
def sources(export: Callable[..., Path]) -> Path:
    """Export the FMUs as C sources; return their folder."""
    return export(ROOT / "target" / "sources", "--fmi", "2.0,3.0", "--sources")


@pytest.fixture(scope="session")
def built(sources: Path, once: Callable[..., Path]) -> Path:
    """Compile the C sources with the program; return the folder of the FMUs with the binaries."""

    def write(folder: Path) -> None:
        for file in sources.glob("*.fmu"):
            command = [PROGRAM, "build", file, "--out", folder / file.name]
            subprocess.run(command, check=True)

    return once("built", write)


@pytest.fixture(scope="session")
def components(export: Callable[..., Path]) -> Path:
    """Export the FMUs with WebAssembly components; return their folder."""
    return export(ROOT / "target" / "wasm", "--fmi", "3.0", "--target", "wasm")


@pytest.fixture(scope="session")
def page_file(components: Path, once: Callable[..., Path]) -> Path:
    """Write the page that runs the FMUs in the browser."""
    once("page", lambda _: subprocess.run([sys.executable, ROOT / "web/build.py"], check=True))
    return ROOT / "target" / "page" / "index.html"


@pytest.fixture(scope="session")
def variant(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the variant that `examples/ssp/supervised.toml` uses; return its file."""
    name = "SupervisedIpidRbf"
    options = ["IpidRbf", "--name", name, "--set", "rbf.target=supervisor"]
    return export(ROOT / "target" / "variants", *options) / f"{name}.fmu"


@pytest.fixture(scope="session")
def sensor(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the example of a sensor; return its file."""
    return export(SENSOR.parent, "--package", "sensor") / SENSOR.name


@pytest.fixture(scope="session")
def can(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the example of a loop over a CAN bus; return its folder."""
    return export(SENSOR.parent, "--package", "can", "--fmi", "3.0")


@pytest.fixture(scope="session")
def equations(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the examples of models with equations for both versions; return their folder."""
    return export(SENSOR.parent, "--package", "equations", "--fmi", "2.0,3.0")


@pytest.fixture(scope="session")
def blocks(fmus: Path, export: Callable[..., Path]) -> Path:
    """Export the examples of controllers made of blocks for both versions; return their folder."""
    return export(SENSOR.parent, "--package", "blocks", "--fmi", "2.0,3.0")


@pytest.fixture(scope="session")
def clocks(export: Callable[..., Path]) -> Path:
    """Export the examples of models with clocks; return their folder."""
    return export(SENSOR.parent, "--package", "clocks", "--fmi", "3.0")


@pytest.fixture(scope="session")
def program(fmus: Path) -> Path:
    """Return the program with the native master, after exporting the FMUs that its examples use."""
    return PROGRAM


@pytest.fixture
def instance(fmus: Path) -> Iterator[Callable[..., Component]]:
    """Return a function that instantiates an FMU and initializes it at `time` [s]."""
    with ExitStack() as stack:

        def instantiate(model: str, start: dict | None = None, time: float = 0.0) -> Component:
            component = stack.enter_context(Component(model, fmus / f"{model}.fmu", start))
            component.initialize(time)
            return component

        yield instantiate


@pytest.fixture(scope="session")
def table_results(fmus: Path, once: Callable[..., Path]) -> dict[Loop, Columns]:
    """Return the results of all runs that Table 1 needs, by the native master.

    `make demo` computes Table 1 with FMPy.
    """
    from pendulum_fmus.report.runs import simulate_all

    def write(folder: Path) -> None:
        with workers() as pool:
            results = simulate_all(table1.runs(), fmus, pool)
        (folder / "results").write_bytes(pickle.dumps(results))

    return pickle.loads((once("table1", write) / "results").read_bytes())


@pytest.fixture(scope="session")
def ssp_columns(program: Path, variant: Path, once: Callable[..., Path]) -> dict[str, Columns]:
    """Return results of the systems of examples/ssp by the native master: e, u and theta."""
    from native import simulate

    systems = {file.stem: file for file in (ROOT / "examples" / "ssp").glob("*.toml")}
    outputs = [f"--output={name}" for name in ("controller.e", "controller.u", "plant.theta")]

    def write(folder: Path) -> None:
        found = {name: simulate(file, folder, *outputs) for name, file in systems.items()}
        (folder / "results").write_bytes(pickle.dumps(found))

    return pickle.loads((once("ssp", write) / "results").read_bytes())


@pytest.fixture(scope="session")
def report_folder(program: Path, sensor: Path, once: Callable[..., Path]) -> Path:
    """Return the folder of a report generated for the tests."""

    def write(folder: Path) -> None:
        command = [sys.executable, "-m", "pendulum_fmus.report", "--out", str(folder)]
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        assert run.stderr == ""
        assert "MISSED" not in run.stdout

    return once("report", write)


@pytest.fixture(scope="module")
def browser() -> Iterator["Browser"]:
    """Return Chromium with a new, empty profile."""
    # Some workflows run tests without Playwright.
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium
        browser = chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield browser
        browser.close()
