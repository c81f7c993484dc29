"""The command line `cargo fmu`: exports, variants, completions, and errors on bad input."""

import ctypes
import os
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from native import printed, read, run, write
from pendulum_fmus.master import Component, MasterError
from pendulum_fmus.project import ROOT
from test_package import MODELS, Fmu, of


def refusal(*arguments: object) -> str:
    """Return the message of an export that must fail."""
    result = run("export", *arguments, cwd=ROOT)
    said = re.sub(r"^building .*\n", "", result.stderr, flags=re.MULTILINE)
    assert said.startswith("error: "), result.stdout
    return said


def library(fmu: Fmu, folder: Path) -> Path:
    """Write the shared library of an FMU to a folder."""
    file = folder / f"{fmu.path.stem}.so"
    file.write_bytes(fmu.read(fmu.library))
    return file


# --- export ---------------------------------------------------------------------------------------


def test_models_and_folder_can_be_selected(fmus: Path, tmp_path: Path) -> None:
    files = {f"{model}{version}.fmu" for model in MODELS for version in ("", "_fmi3")}
    assert {file.name for file in fmus.glob("*.fmu")} == files
    said = printed("export", "Pid", "Source", "--out", tmp_path / "a" / "b", cwd=ROOT)
    assert sorted(os.listdir(tmp_path / "a" / "b")) == ["Pid.fmu", "Source.fmu"]
    assert len(said.splitlines()) == 2
    message = refusal("Pidd")
    assert all(model in message for model in [*MODELS, '"Pidd"'])


def test_the_same_input_gives_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    # What the user's environment may have must not change them.
    others = {"CARGO_INCREMENTAL": "1", "CARGO_BUILD_TARGET": "wasm32-unknown-unknown"}
    others |= {"FMU_EXPORT_VARIANT": "other", "CARGO_BUILD_RUSTFLAGS": "-Ctarget-cpu=native"}
    result = run("export", "--fmi", "2.0,3.0", "--out", tmp_path, cwd=ROOT, env=os.environ | others)
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.iterdir())) == 2 * len(MODELS)
    for again in tmp_path.iterdir():
        assert (fmus / again.name).read_bytes() == again.read_bytes(), again.name


def test_a_prebuilt_binary_replaces_a_build(fmus: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for version, platform in (("2.0", "linux64"), ("3.0", "x86_64-linux")):
        fmu = of(fmus, "Source", version)
        binary = f"--binary={platform}={library(fmu, tmp_path)}"
        printed("export", "Source", "--fmi", version, binary, "--out", out, cwd=ROOT)
        assert (out / fmu.path.name).read_bytes() == fmu.path.read_bytes()


def test_a_binary_of_another_model_format_or_version_is_rejected(fmus, tmp_path) -> None:
    old, new = (library(of(fmus, "Source", version), tmp_path) for version in ("2.0", "3.0"))
    for arguments, binary, expected in (
        ("Pid", f"linux64={old}", "does not contain the model Pid"),
        ("Source", f"win64={old}", "win64"),
        ("Source --fmi 3.0", f"linux64={new}", "cannot be used for FMI 3.0"),
        ("Source --fmi 3.0", f"x86_64-linux={old}", "does not export the functions of FMI 3.0"),
    ):
        options = ["--binary", binary, "--out", tmp_path / "out"]
        assert expected in refusal(*arguments.split(), *options)
    assert not list((tmp_path / "out").iterdir()), "nothing is half-written"


def test_exports_side_by_side_do_not_take_the_library_of_each_other(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = tmp_path / "cargo"  # Another cargo could build before this one has ended.
    real = shutil.which("cargo")
    slow.write_text(f'#!/bin/sh\n{real} "$@" || exit\n[ "$1" != rustc ] || sleep 2\n')
    slow.chmod(0o755)
    monkeypatch.setenv("CARGO", str(slow))
    with ThreadPoolExecutor() as pool:
        export = ["export", "Source", "--out", tmp_path, "--fmi"]
        list(pool.map(lambda version: printed(*export, version, cwd=ROOT), ("2.0", "3.0")))
    for version in ("2.0", "3.0"):
        fmu = of(fmus, "Source", version)
        assert (tmp_path / fmu.path.name).read_bytes() == fmu.path.read_bytes()


@pytest.mark.parametrize("target", ["i686-unknown-linux-musl", "universal2-apple-darwin"])
def test_the_error_for_a_target_without_standard_library_gives_remedies(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = tmp_path / "rustc"  # without a standard library for any target
    real = shutil.which("rustc")
    compiler.write_text(f'#!/bin/sh\n[ "$1" = --print ] && echo /missing || exec {real} "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CARGO", shutil.which("cargo"))
    monkeypatch.setenv("RUSTC", str(compiler))
    monkeypatch.setenv("PATH", str(tmp_path))
    message = refusal("--target", target, "--out", tmp_path / "out")
    for remedy in ("rustup target add", "rustup component add rust-src", "rust-web-src"):
        assert remedy in message


def test_one_error_lists_all_that_the_targets_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CARGO", shutil.which("cargo"))
    monkeypatch.setenv("RUSTC", shutil.which("rustc"))
    monkeypatch.setenv("PATH", str(tmp_path))
    targets = ["x86_64-pc-windows-gnu", "universal2-apple-darwin"]
    options = [word for target in targets for word in ("--target", target)]
    message = refusal(*options, "--fmi", "2.0,3.0", "--out", tmp_path / "out")
    for command in ("apt-get install gcc-mingw-w64-x86-64", "pip install cargo-zigbuild ziglang"):
        assert message.count(command) == 1


def test_a_platform_suggests_its_target(tmp_path: Path) -> None:
    message = refusal("--target", "win64", "--out", tmp_path)
    assert "did you mean x86_64-pc-windows-" in message


# --- variants -------------------------------------------------------------------------------------


def test_a_variant_has_other_start_values(fmus: Path, variant: Path) -> None:
    with (
        Component("variant", variant, {"pid.kp": 1.0}) as own,
        Component("base", fmus / "IpidRbf.fmu") as base,
    ):
        assert own.description.guid != base.description.guid
        starts = {name: base.variables[name].start for name in base.variables}
        found = {name: own.variables[name].start for name in own.variables}
        assert found == starts | {"rbf.target": "2"}
        own.initialize(0.0)
        assert own.get("pid.kp") == 1.0
    validate = run("validate", "--quick", variant)
    assert "no error, no warning" in validate.stdout, validate.stdout


def test_settings_that_cannot_be_used_are_refused(fmus: Path) -> None:
    for options, message in (
        (["--set", "pid.kp=-1"], "--set pid.kp=-1 cannot be used: expected a number from 0 to"),
        (["--name", "PidRbf"], "--name PidRbf: there is a model with this name"),
        (["Source", "--name", "Both"], "--name and --set need one model, but 2 are exported"),
    ):
        assert message in refusal("Pid", *options)


def test_flat_names_are_those_of_settings_xml_and_messages(fmus: Path, tmp_path: Path) -> None:
    options = ["--naming", "flat", "--set", "pid.kp=1", "--set", "pid_kd=2"]
    printed("export", "Pid", *options, "--out", tmp_path, cwd=ROOT)
    with (
        Component("flat", tmp_path / "Pid.fmu", {"pid_ki": 3.0}) as flat,
        Component("base", fmus / "Pid.fmu") as base,
    ):
        assert flat.description.variableNamingConvention == "flat"
        assert flat.description.guid != base.description.guid
        starts = {name.replace(".", "_"): base.variables[name].start for name in base.variables}
        found = {name: flat.variables[name].start for name in flat.variables}
        assert found == starts | {"pid_kp": "1", "pid_kd": "2"}
        flat.initialize(0.0)
        with pytest.raises(MasterError, match=r"pid_kp = -1 is refused"):
            flat.set("pid_kp", -1.0)
    assert "no error, no warning" in run("validate", "--quick", tmp_path / "Pid.fmu").stdout


def test_an_fmu_for_one_interface_type_has_nothing_of_the_other(fmus: Path, tmp_path: Path) -> None:
    options = ["Pid", "--fmi", "2.0,3.0", "--interface", "co-simulation"]
    printed("export", *options, "--out", tmp_path, cwd=ROOT)
    for version, platform in (("2.0", "linux64"), ("3.0", "x86_64-linux")):
        both, one = (of(folder, "Pid", version) for folder in (fmus, tmp_path))
        assert one.description.modelExchange is None
        assert one.description.coSimulation is not None
        assert one.description.guid == both.description.guid
        assert len(one.read(one.library)) < len(both.read(both.library))
        binary = library(one, tmp_path)
        functions = ctypes.CDLL(str(binary))
        assert hasattr(functions, f"fmi{version[0]}DoStep")
        assert not hasattr(functions, f"fmi{version[0]}SetTime")
        rows = [tmp_path / f"{name}.csv" for name in ("both", "one")]
        for fmu, file in zip((both, one), rows, strict=True):
            printed("simulate", fmu.path, "--stop", 0.1, "--csv", file)
        assert rows[0].read_bytes() == rows[1].read_bytes()
        assert "no error, no warning" in run("validate", "--quick", one.path).stdout
        # It cannot be the binary of an FMU for both types: the export refuses it, and itself.
        arguments = ["Pid", "--fmi", version, "--binary", f"{platform}={binary}"]
        message = refusal(*arguments, "--out", tmp_path / "out")
        assert f"functions of FMI {version} for model exchange" in message
        mixed = write(tmp_path / "mixed.fmu", read(both.path) | {one.library: binary.read_bytes()})
        failed = run("simulate", mixed, "--interface", "model-exchange")
        assert "Pid is for co-simulation, not for model exchange" in failed.stderr


# --- completions ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "offered"),
    [("cargo fmu ex", "export"), ("cargo fmu export --ta", "--target"), ("cargo bu", "build")],
)
def test_bash_completes_after_cargo_fmu(words: str, offered: str, tmp_path: Path) -> None:
    script = tmp_path / "completions.sh"
    script.write_text(run("completions", "bash").stdout)
    # Reloading ~/.bashrc sources the script again.
    commands = f"""
        before() {{ COMPREPLY=(build); }}
        complete -F before cargo
        source {script}
        source {script}
        COMP_WORDS=({words}) COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
        _cargo_fmu_after_cargo cargo "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
        echo "${{COMPREPLY[@]}}"
    """
    bash = ["bash", "--norc", "-c", commands]
    done = subprocess.run(bash, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == offered
