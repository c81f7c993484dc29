"""Packages outside the repository: `cargo fmu new`, and all ways to export them."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest

from native import read_csv
from pendulum_fmus.master import Component, MasterError, System, simulate
from pendulum_fmus.project import PROGRAM, ROOT

OWN = ROOT / "tests" / "data" / "own"
"""A package with a feature, a program, resources, metadata, and a renamed dependency."""

WORKSPACE = """\
[workspace]
resolver = "3"
members = ["own"]

[profile.release]
panic = "abort"

[profile.quick]
inherits = "release"
lto = false
opt-level = 1
"""


def run(*command: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command outside the repository, whatever its exit code."""
    environment = {name: os.environ[name] for name in os.environ if name != "CARGO_TARGET_DIR"}
    return subprocess.run(
        list(map(str, command)),
        cwd=cwd, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


def succeed(*command: object, cwd: Path) -> str:
    """Run a command, which must succeed, and return its output."""
    result = run(*command, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export a workspace with a new package and one that uses the crates by git."""
    succeed("cargo", "build", "--package", "cargo-fmu", cwd=ROOT)
    folder = tmp_path_factory.mktemp("outside")
    repository = folder / "repository"
    ignored = shutil.ignore_patterns("target", ".git", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, repository, ignore=ignored)
    commit = ["-c", "user.name=test", "-c", "user.email=test", "commit", "--quiet", "-m", "copy"]
    for command in (["init", "--quiet"], ["add", "--all"], commit):
        succeed("git", *command, cwd=repository)

    workspace = folder / "workspace"
    shutil.copytree(OWN, workspace / "own")
    manifest = workspace / "own" / "Cargo.toml"
    manifest.write_text(manifest.read_text().replace("[REPOSITORY]", repository.as_uri()))
    (workspace / "Cargo.toml").write_text(WORKSPACE)
    succeed(PROGRAM, "new", "my-controller", cwd=workspace)
    succeed(PROGRAM, "export", cwd=workspace)
    return workspace


@pytest.fixture(scope="module")
def exported(workspace: Path) -> Path:
    """Return the folder of the FMUs."""
    return workspace / "target" / "fmu"


# --- a new package --------------------------------------------------------------------------------


def test_a_new_package_passes_its_test_and_all_lints(workspace: Path) -> None:
    package = workspace / "my-controller"
    assert "1 passed" in succeed("cargo", "test", cwd=package)
    succeed("cargo", "fmt", "--check", "--package", "my-controller", cwd=package)
    succeed("cargo", "clippy", "--all-targets", "--", "--deny", "warnings", cwd=package)


def test_new_fmus_have_no_findings(exported: Path) -> None:
    files = sorted(exported.glob("*.fmu"))
    assert [file.stem for file in files] == ["MyController", "MyControllerPlant", "Own"]
    lines = succeed(PROGRAM, "validate", *files, cwd=exported).splitlines()
    assert len(lines) == 3
    assert all("no error, no warning" in line for line in lines)


def test_the_loop_of_a_new_package_closes_in_the_native_master_and_in_fmpy(
    workspace: Path, exported: Path, tmp_path: Path
) -> None:
    csv = tmp_path / "loop.csv"
    succeed(PROGRAM, "simulate", "loop.toml", "--csv", csv, cwd=workspace / "my-controller")
    native = read_csv(csv)
    controller = exported / "MyController.fmu", {"r": 100.0}
    plant = exported / "MyControllerPlant.fmu"
    with System(
        [Component("controller", *controller, sampled=True), Component("plant", plant)],
        [("plant.y", "controller.y"), ("controller.u", "plant.u")],
    ) as system:
        results = simulate(system, start=0.0, step=0.01, steps=201)
    for name in ("controller.u", "plant.y"):
        assert results[name].tolist() == native[name].tolist()
    assert results["plant.y"][-1] == pytest.approx(100.0, rel=1e-3)


# --- selecting packages, features and profiles ----------------------------------------------------


def test_packages_are_selected_as_in_cargo(workspace: Path, tmp_path: Path) -> None:
    def export(*options: object, cwd: Path) -> list[str]:
        out = tmp_path / f"{len(os.listdir(tmp_path))}"
        succeed(PROGRAM, "export", *options, "--out", out, cwd=cwd)
        return sorted(file.stem for file in out.iterdir())

    assert export("--package", "own", cwd=workspace) == ["Own"]
    assert export(cwd=workspace / "my-controller") == ["MyController", "MyControllerPlant"]
    manifest = workspace / "own" / "Cargo.toml"
    assert export("--manifest-path", manifest, cwd=tmp_path) == ["Own"]
    assert export("MyControllerPlant", cwd=workspace) == ["MyControllerPlant"]


@pytest.fixture(scope="module")
def doubled(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Export the own model with a feature and another profile."""
    out = tmp_path_factory.mktemp("doubled")
    options = ["--package", "own", "--features", "doubled", "--profile", "quick"]
    succeed(PROGRAM, "export", *options, "--out", out, cwd=workspace)
    return out / "Own.fmu"


def test_features_and_profiles_are_those_of_cargo(workspace: Path, doubled: Path) -> None:
    with Component("own", doubled, {"u": 1.0}) as own:
        own.initialize(0.0)
        own.step(0.0, 0.1)
        assert own.get("y") == 2 * (1.0 + 0.25)
    assert (workspace / "target" / "quick").is_dir()


@pytest.mark.parametrize("build", ["release", "quick"])
def test_a_profile_that_aborts_is_overridden(build: str, exported: Path, doubled: Path) -> None:
    fmu = exported / "Own.fmu" if build == "release" else doubled
    with Component("own", fmu, {"u": -1.0}) as own:
        own.initialize(0.0)
        with pytest.raises(MasterError, match=r"status 4: .*u is negative"):
            own.step(0.0, 0.1)


def test_binaries_contain_no_path_of_this_machine(workspace: Path, exported: Path) -> None:
    for file in exported.glob("*.fmu"):
        with zipfile.ZipFile(file) as archive:
            binary = archive.read(f"binaries/linux64/{file.stem}.so")
        for path in (ROOT, Path.home(), workspace.parent):
            assert os.fsencode(path) + b"/" not in binary, f"{file.stem} contains {path}"


# --- the author's files ---------------------------------------------------------------------------


def test_version_authors_licence_and_copyright_are_those_of_the_package(exported: Path) -> None:
    with zipfile.ZipFile(exported / "Own.fmu") as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        page = archive.read("documentation/index.html").decode()
        licence = archive.read("documentation/licenses/LICENSE.txt")
        names = archive.namelist()
    assert licence == (OWN / "LICENSE.txt").read_bytes()
    assert [name for name in names if "licenses/" in name] == ["documentation/licenses/LICENSE.txt"]
    for attribute, value in {
        "version": "2.3.4",
        "author": "First Author, Second Author",
        "license": "EUPL-1.2",
        "copyright": "© First Author",
    }.items():
        assert root.get(attribute) == value
        assert value in page, attribute


def test_resources_are_found_by_the_model(exported: Path) -> None:
    with Component("own", exported / "Own.fmu", {"u": 1.0}) as own:
        own.initialize(0.0)
        own.step(0.0, 0.1)
        assert own.get("y") == 1.0 + 0.25


def test_a_missing_resource_is_reported(exported: Path, tmp_path: Path) -> None:
    fmpy.extract(exported / "Own.fmu", tmp_path / "unpacked")
    (tmp_path / "unpacked" / "resources" / "data" / "offset.txt").unlink()
    archive = shutil.make_archive(str(tmp_path / "Own"), "zip", tmp_path / "unpacked")
    message = r"cannot read the resource .*data/offset\.txt: No such file"
    with Component("own", archive) as own, pytest.raises(MasterError, match=message):
        own.initialize(0.0)


# --- errors ---------------------------------------------------------------------------------------


def test_errors_of_the_compiler_are_shown(workspace: Path, tmp_path: Path) -> None:
    library = workspace / "own" / "src" / "lib.rs"
    text = library.read_text()
    library.write_text(text.replace('unit = "m"', 'unit = "furlong"', 1))
    try:
        result = run(PROGRAM, "export", "--package", "own", "--out", tmp_path, cwd=workspace)
    finally:
        library.write_text(text)
    assert result.returncode == 1
    assert result.stderr.startswith("error: building own failed:\n")
    assert "furlong" in result.stderr
    assert "--> own/src/lib.rs:" in result.stderr
    assert not list(tmp_path.iterdir())
