"""The command line `cargo fmu`: exports, variants, `info`, completions, and errors on bad input."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from pendulum_fmus.master import Component
from pendulum_fmus.project import PROGRAM, ROOT
from test_package import MODELS, Fmu, of


def cargo_fmu(*arguments: str | Path, **options) -> subprocess.CompletedProcess[str]:
    """Run the command line from the project's root, whatever its exit code."""
    command = [str(PROGRAM), *map(str, arguments)]
    options = {"cwd": ROOT, "capture_output": True, "text": True, "check": False} | options
    return subprocess.run(command, **options)


def refusal(*arguments: str | Path) -> str:
    """Run `cargo fmu`, which must fail without a panic, and return its message."""
    result = cargo_fmu(*arguments)
    assert result.returncode != 0, result.stdout
    assert "panicked" not in result.stderr
    assert result.stderr.startswith("error: "), result.stderr
    return result.stderr


def library(fmu: Fmu, folder: Path) -> Path:
    """Write the shared library of an FMU to a folder."""
    file = folder / f"{fmu.path.stem}.so"
    file.write_bytes(fmu.read(fmu.library))
    return file


# --- export ---------------------------------------------------------------------------------------


def test_models_and_folder_can_be_selected(fmus: Path, tmp_path: Path) -> None:
    files = {f"{model}{version}.fmu" for model in MODELS for version in ("", "_fmi3")}
    assert {file.name for file in fmus.glob("*.fmu")} == files
    result = cargo_fmu("export", "Pid", "Source", "--out", tmp_path / "a" / "b")
    assert result.returncode == 0, result.stderr
    assert sorted(os.listdir(tmp_path / "a" / "b")) == ["Pid.fmu", "Source.fmu"]
    assert len(result.stdout.splitlines()) == 2
    message = refusal("export", "Pidd")
    assert all(model in message for model in [*MODELS, '"Pidd"'])


def test_the_same_input_gives_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    for version in ("2.0", "3.0"):
        assert cargo_fmu("export", "--fmi", version, "--out", tmp_path).returncode == 0
    assert len(list(tmp_path.iterdir())) == 2 * len(MODELS)
    for again in tmp_path.iterdir():
        assert (fmus / again.name).read_bytes() == again.read_bytes(), again.name


def test_a_prebuilt_binary_replaces_a_build(fmus: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for version, platform in (("2.0", "linux64"), ("3.0", "x86_64-linux")):
        fmu = of(fmus, "Source", version)
        binary = f"--binary={platform}={library(fmu, tmp_path)}"
        assert cargo_fmu("export", "Source", "--fmi", version, binary, "--out", out).returncode == 0
        assert (out / fmu.path.name).read_bytes() == fmu.path.read_bytes()


def test_a_binary_of_another_model_format_or_version_is_rejected(
    fmus: Path, tmp_path: Path
) -> None:
    old, new = (library(of(fmus, "Source", version), tmp_path) for version in ("2.0", "3.0"))
    for arguments, binary, expected in (
        ("Pid", f"linux64={old}", "does not contain the model Pid"),
        ("Source", f"win64={old}", "win64"),
        ("Source", f"linux64={tmp_path / 'nothing.so'}", "nothing.so"),
        ("Source --fmi 3.0", f"linux64={new}", "cannot be used for FMI 3.0"),
        ("Source --fmi 3.0", f"x86_64-linux={old}", "does not export the functions of FMI 3.0"),
    ):
        options = ["--binary", binary, "--out", tmp_path / "out"]
        assert expected in refusal("export", *arguments.split(), *options)
    assert not list((tmp_path / "out").iterdir()), "nothing is half-written"


@pytest.mark.parametrize("target", ["i686-unknown-linux-musl", "universal2-apple-darwin"])
def test_the_error_for_a_target_without_standard_library_gives_remedies(
    target: str, tmp_path: Path
) -> None:
    compiler = tmp_path / "rustc"  # without a standard library for any target
    real = shutil.which("rustc")
    compiler.write_text(f'#!/bin/sh\n[ "$1" = --print ] && echo /missing || exec {real} "$@"\n')
    compiler.chmod(0o755)
    tools = {"CARGO": shutil.which("cargo"), "RUSTC": str(compiler), "PATH": str(tmp_path)}
    command = [PROGRAM, "export", "--target", target, "--out", tmp_path / "out"]
    environment = os.environ | tools
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert result.returncode == 1
    for remedy in ("rustup target add", "rustup component add rust-src", "rust-web-src"):
        assert remedy in result.stderr


# --- variants -------------------------------------------------------------------------------------


def test_a_variant_has_other_start_values(fmus: Path, tmp_path: Path) -> None:
    settings = {"pid.kp": "400", "ts": "0.0005", "anti_windup": "true"}
    options = ["--name", "FastPid", *(f"--set={name}={value}" for name, value in settings.items())]
    result = cargo_fmu("export", "Pid", *options, "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    (file,) = tmp_path.iterdir()
    assert file.name == "FastPid.fmu"
    with (
        Component("variant", file, {"pid.kp": 1.0}) as variant,
        Component("base", fmus / "Pid.fmu") as base,
    ):
        assert variant.description.guid != base.description.guid
        starts = {name: base.variables[name].start for name in base.variables}
        assert {name: v.start for name, v in variant.variables.items()} == starts | settings
        variant.initialize(0.0)
        assert variant.get("pid.kp") == 1.0
    validate = cargo_fmu("validate", "--quick", file)
    assert "no error, no warning" in validate.stdout, validate.stdout
    # The base is unchanged.
    assert cargo_fmu("export", "Pid", "--out", tmp_path).returncode == 0
    assert (tmp_path / "Pid.fmu").read_bytes() == (fmus / "Pid.fmu").read_bytes()


def test_settings_that_cannot_be_used_are_refused(fmus: Path) -> None:
    for options, message in (
        (["--set", "pid.kp=-1"], "--set pid.kp=-1 cannot be used: expected a number from 0 to"),
        (["--name", "PidRbf"], "--name PidRbf: there is a model with this name"),
        (["Source", "--name", "Both"], "--name and --set need one model, but 2 are exported"),
    ):
        assert message in refusal("export", "Pid", *options)


# --- info and completions -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "offered"),
    [("cargo fmu ex", "export"), ("cargo fmu export --ta", "--target"), ("cargo bu", "")],
)
def test_bash_completes_after_cargo_fmu(words: str, offered: str, tmp_path: Path) -> None:
    script = tmp_path / "completions.sh"
    script.write_text(cargo_fmu("completions", "bash").stdout)
    program = f"""
        source {script}
        COMP_WORDS=({words}) COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
        _cargo_fmu_after_cargo cargo "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
        echo "${{COMPREPLY[@]}}"
    """
    bash = [shutil.which("bash") or pytest.skip("no bash"), "--norc", "-c", program]
    assert (
        subprocess.run(bash, capture_output=True, text=True, check=True).stdout.strip() == offered
    )
