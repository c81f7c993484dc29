"""Packages outside the repository: `cargo fmu new`, and all ways to export them."""

import math
import os
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess
from xml.etree import ElementTree

import fmpy
import pytest

from native import call, prepare, read, read_csv, started
from pendulum_fmus.master import Component, FmpySystem, MasterError, simulate
from pendulum_fmus.project import PROGRAM, ROOT

OWN = ROOT / "tests" / "data" / "own"
"""A package with a feature, a program, resources, metadata, and a renamed dependency."""

WORKSPACE = '[workspace]\nresolver = "3"\nmembers = ["own"]\n'


def run(*command: object, cwd: Path) -> str:
    """Run a command outside the repository, which must succeed; return its output."""
    result = call(command, cwd)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export a workspace with a new package and another one."""
    workspace = tmp_path_factory.mktemp("outside") / "workspace"
    shutil.copytree(OWN, workspace / "own")
    manifest = workspace / "own" / "Cargo.toml"
    manifest.write_text(manifest.read_text().replace("[REPOSITORY]", str(ROOT)))
    (workspace / "Cargo.toml").write_text(WORKSPACE)
    run(PROGRAM, "new", "../my-controller", cwd=workspace / "own")
    run(PROGRAM, "new", "pump", "--c", "--no-plant", cwd=workspace)
    run(PROGRAM, "export", cwd=prepare(workspace))
    return workspace


@pytest.fixture(scope="module")
def exported(workspace: Path) -> Path:
    """Return the folder of the FMUs."""
    return workspace / "target" / "fmu"


# --- a new package --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["my-controller", "pump"])
def test_a_new_package_passes_its_test_and_all_lints(workspace: Path, name: str) -> None:
    package = workspace / name
    assert "1 passed" in run("cargo", "test", cwd=package)
    run("cargo", "fmt", "--check", "--package", name, cwd=package)
    run("cargo", "clippy", "--all-targets", "--", "--deny", "warnings", cwd=package)


def test_the_first_model_of_the_docs_is_that_of_a_new_package(workspace: Path) -> None:
    page = (ROOT / "docs" / "start.md").read_text()
    model = page.split("```rust\n")[1].split("```")[0]
    assert model in (workspace / "my-controller" / "src" / "lib.rs").read_text()


def test_new_fmus_have_no_findings(exported: Path) -> None:
    """The last one has a bug for some inputs, which cannot change then."""
    models = ("MyController", "MyControllerPlant", "Pump", "Own")
    files = [exported / f"{model}.fmu" for model in models]
    *clean, warning, last = run(PROGRAM, "validate", *files, cwd=exported).splitlines()
    assert [line.endswith("no error, no warning") for line in clean] == [True] * 3
    assert "not tested: changes of inputs, which it refuses" in warning
    assert last.endswith("no error, 1 warning")


def test_the_loop_of_a_new_package_closes_in_the_native_master_and_in_fmpy(
    workspace: Path, exported: Path, tmp_path: Path
) -> None:
    csv = tmp_path / "loop.csv"
    run(PROGRAM, "simulate", "loop.toml", "--csv", csv, cwd=workspace / "my-controller")
    native = read_csv(csv)
    controller = exported / "MyController.fmu", {"r": 100.0}
    plant = exported / "MyControllerPlant.fmu"
    with FmpySystem(
        [Component("controller", *controller, sampled=True), Component("plant", plant)],
        [("plant.y", "controller.y"), ("controller.u", "plant.u")],
    ) as system:
        results = simulate(system, start=0.0, step=0.01, steps=201)
    for name in ("controller.u", "plant.y"):
        assert results[name].tolist() == native[name].tolist()
    assert results["plant.y"][-1] == pytest.approx(100.0, rel=1e-3)


def test_an_fmu_that_is_older_than_its_sources_is_told(workspace: Path, exported: Path) -> None:
    package = workspace / "my-controller"
    source = package / "src" / "plant.rs"
    simulate = [PROGRAM, "simulate", "loop.toml"]
    text = source.read_text()
    try:
        source.write_text(text + "// changed\n")
        said = call(simulate, package).stderr
        assert "MyController.fmu and " in said
        assert "src/plant.rs has changed; `cd " in said
    finally:
        source.write_text(text)
    assert "older than" not in call(simulate, package).stderr
    controller = exported / "MyController.fmu"
    controller.rename(hidden := exported / "hidden.fmu")
    try:
        assert "cargo fmu export` builds it" in call(simulate, package).stderr
    finally:
        hidden.rename(controller)


def test_run_builds_and_simulates_again_after_a_change(workspace: Path, tmp_path: Path) -> None:
    package, csv = workspace / "my-controller", tmp_path / "run.csv"
    source = package / "src" / "plant.rs"
    text = source.read_text()
    command = [PROGRAM, "run", "MyControllerPlant", "--set", "u=1", "--csv", csv, "--watch"]
    with started(command, package) as process:
        try:
            for gain in (10, 20):
                lines = iter(process.stdout.readline, "")
                assert any(line.startswith("waiting for a change") for line in lines)
                # The step response of the motor after four time constants.
                expected = gain * (1.0 - math.exp(-4.0))
                assert read_csv(csv)["y"][-1] == pytest.approx(expected, rel=1e-12)
                source.write_text(text.replace("start = 10", "start = 20"))
        finally:
            process.terminate()
            source.write_text(text)
    assert process.returncode == 128 + signal.SIGTERM


def test_an_export_has_the_references_of_the_package(exported: Path, tmp_path: Path) -> None:
    """The page on references has the same experiment."""
    own = exported / "Own.fmu"
    related = [
        line.split(": ")[0].split("/")[-1]
        for line in run(PROGRAM, "info", own, cwd=tmp_path).splitlines()
        if "fmi-ls-ref/" in line
    ]
    assert related == ["experiments.exp", "length.ssv", "sums.csv"]
    csv = tmp_path / "sums.csv"
    run(PROGRAM, "simulate", own, "--experiment", "sum", "--csv", csv, cwd=tmp_path)
    assert read_csv(csv)["y"].tolist() == [0.0, 1.25, 2.25, 3.25]
    run(PROGRAM, "simulate", own, "--parameters", "length", "--stop=1", "--csv", csv, cwd=tmp_path)
    assert read_csv(csv)["y"][-1] == 2.25


# --- selecting packages and features --------------------------------------------------------------


def test_packages_are_selected_as_in_cargo(workspace: Path, tmp_path: Path) -> None:
    manifest = workspace / "own" / "Cargo.toml"
    for options, folder, models in (
        (["--package", "own"], workspace, ["Own"]),
        ([], workspace / "my-controller", ["MyController", "MyControllerPlant"]),
        (["--manifest-path", manifest], tmp_path, ["Own"]),
        (["MyControllerPlant"], workspace, ["MyControllerPlant"]),
    ):
        shutil.rmtree(out := tmp_path / "out", ignore_errors=True)
        run(PROGRAM, "export", *options, "--out", out, cwd=folder)
        assert sorted(file.stem for file in out.iterdir()) == models


def output(fmu: Path, u: float = 1.0) -> float:
    """Return the output of the own model, to which a resource adds 0.25, after a step."""
    with Component("own", fmu, {"u": u}) as own:
        own.initialize(0.0)
        own.step(0.0, 0.1)
        return own.get("y")


def test_features_are_those_of_cargo_but_a_panic_never_aborts(workspace, exported, tmp_path):
    """`native.call` has the other profile."""
    options = ["--package", "own", "--features", "doubled"]
    said = call([PROGRAM, "export", *options, "--out", tmp_path], workspace).stderr
    assert 'warning: Own.fmu: the name "model" is a keyword in Modelica, expected another' in said
    assert output(tmp_path / "Own.fmu") == 2 * (1.0 + 0.25)
    with pytest.raises(MasterError, match=r"status 4: .*u is negative"):
        output(exported / "Own.fmu", -1.0)


def test_binaries_contain_no_path_of_this_machine(workspace: Path, exported: Path) -> None:
    binary = read(exported / "Own.fmu")["binaries/linux64/Own.so"]
    cargo_home = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo"))
    for path in (ROOT, Path.home(), cargo_home, workspace.parent):
        assert os.fsencode(path) + b"/" not in binary, f"it contains {path}"


# --- the author's files ---------------------------------------------------------------------------


def test_metadata_and_naming_are_those_of_the_package(exported: Path) -> None:
    files = read(exported / "Own.fmu")
    root = ElementTree.fromstring(files["modelDescription.xml"])
    page = files["documentation/index.html"].decode()
    licences = {name: text for name, text in files.items() if "licenses/" in name}
    licence = (OWN / "LICENSE.txt").read_bytes()
    assert licences == {"documentation/licenses/LICENSE.txt": licence}
    for attribute, value in {
        "version": "2.3.4",
        "author": "First Author, Second Author",
        "license": "EUPL-1.2",
        "copyright": "© First Author",
        "variableNamingConvention": "flat",
    }.items():
        assert root.get(attribute) == value
        assert value in page or value == "flat", attribute


def test_resources_are_found_by_the_model_or_reported(exported: Path, tmp_path: Path) -> None:
    assert output(exported / "Own.fmu") == 1.0 + 0.25
    fmpy.extract(exported / "Own.fmu", tmp_path / "unpacked")
    (tmp_path / "unpacked" / "resources" / "data" / "offset.txt").unlink()
    archive = shutil.make_archive(str(tmp_path / "Own"), "zip", tmp_path / "unpacked")
    message = r"cannot read the resource .*data/offset\.txt: No such file"
    with pytest.raises(MasterError, match=message):
        output(Path(archive))


# --- errors ---------------------------------------------------------------------------------------


@pytest.fixture
def changed(workspace: Path, tmp_path: Path) -> Iterator[Callable[[str, str], CompletedProcess]]:
    """Return a function that exports the own package to a folder with a text of it replaced."""
    library = workspace / "own" / "src" / "lib.rs"
    text = library.read_text()

    def export(old: str, new: str) -> CompletedProcess:
        library.write_text(text.replace(old, new, 1))
        result = call([PROGRAM, "export", "--package", "own", "--out", tmp_path], workspace)
        # A slow build tells its progress.
        result.stderr = re.sub(r"(?m)^building \w+: .*\n", "", result.stderr)
        return result

    yield export
    library.write_text(text)


def test_errors_of_the_compiler_are_shown(changed, tmp_path: Path) -> None:
    result = changed('unit = "m"', 'unit = "furlong"')
    assert result.returncode == 1
    assert result.stderr.startswith("building own ...\nerror: building own failed:\n")
    assert "furlong" in result.stderr
    assert "--> own/src/lib.rs:" in result.stderr
    assert not list(tmp_path.iterdir())


def test_warnings_of_the_compiler_are_shown(changed, tmp_path: Path) -> None:
    result = changed("use ", "fn forgotten() {}\nuse ")
    assert result.returncode == 0, result.stderr
    assert result.stderr.startswith("building own ...\nwarning: function `forgotten` is never used")
    assert [file.name for file in tmp_path.iterdir()] == ["Own.fmu"]


# --- C code with global variables -----------------------------------------------------------------


@pytest.fixture
def heater(tmp_path: Path) -> Path:
    """Return a copy of a package with a controller in C."""
    package = tmp_path / "heater"
    shutil.copytree(ROOT / "tests" / "data" / "heater", package)
    manifest = package / "Cargo.toml"
    manifest.write_text(manifest.read_text().replace("[REPOSITORY]", str(ROOT)))
    return prepare(package)


def test_each_instance_has_its_own_global_variables_of_c_code(heater: Path) -> None:
    """The validator compares instances, threads, resets, saved and serialized states."""
    assert "3 passed" in run("cargo", "test", cwd=heater)
    run(PROGRAM, "export", "--out", "fmus", cwd=heater)
    checked = run(PROGRAM, "validate", "fmus/Heater.fmu", cwd=heater)
    assert checked.endswith("no error, no warning\n")
    fmu = read(heater / "fmus" / "Heater.fmu")
    assert b'canSerializeFMUstate="true"' in fmu["modelDescription.xml"]


def test_c_code_that_cannot_be_isolated_is_refused(heater: Path) -> None:
    source = heater / "c" / "heater_data.c"
    text = source.read_text()
    for code, message in (
        (
            "#include <stdlib.h>\nvoid *block(void) { return malloc(8); }",
            "heater_data.c calls malloc",
        ),
        ("_Thread_local int own = 1;", "heater_data.c: it has thread-local variables"),
    ):
        source.write_text(text + code)
        result = call(["cargo", "check"], heater)
        assert result.returncode != 0
        assert message in result.stderr
