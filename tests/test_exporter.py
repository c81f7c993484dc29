"""The command line `cargo fmu`: files, output, and errors on bad input."""

import os
import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from pendulum_fmus.master import Component

ROOT = Path(__file__).resolve().parent.parent
MODELS = ["IpidRbf", "Pendulum", "Pid", "PidRbf", "Source"]


def cargo_fmu(*arguments: str | Path, **options) -> subprocess.CompletedProcess[str]:
    """Run `cargo fmu` from the project's root, whatever its exit code."""
    return subprocess.run(
        ["cargo", "fmu", *map(str, arguments)],
        cwd=options.pop("cwd", ROOT),
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


def refusal(*arguments: str | Path, **options) -> str:
    """Run `cargo fmu`, which must fail without a panic, and return its message."""
    result = cargo_fmu(*arguments, **options)
    assert result.returncode != 0, result.stdout
    assert "panicked" not in result.stderr
    assert result.stderr.startswith("error: "), result.stderr
    return result.stderr


def library(fmus: Path, model: str, folder: Path) -> Path:
    """Extract the shared library from an FMU."""
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        return Path(archive.extract(f"binaries/linux64/{model}.so", folder))


# --- export ---------------------------------------------------------------------------------------


def test_all_models_are_exported(fmus: Path) -> None:
    files = {f"{model}{version}.fmu" for model in MODELS for version in ("", "_fmi3")}
    assert {file.name for file in fmus.glob("*.fmu")} == files


def test_models_and_folder_can_be_selected(fmus: Path, tmp_path: Path) -> None:
    result = cargo_fmu("export", "Pid", "Source", "--out", tmp_path / "a" / "b")
    assert result.returncode == 0, result.stderr
    assert sorted(os.listdir(tmp_path / "a" / "b")) == ["Pid.fmu", "Source.fmu"]
    assert len(result.stdout.splitlines()) == 2


def test_the_same_input_gives_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    for version in ("2.0", "3.0"):
        assert cargo_fmu("export", "--fmi", version, "--out", tmp_path).returncode == 0
    assert len(list(tmp_path.iterdir())) == 2 * len(MODELS)
    for again in tmp_path.iterdir():
        assert (fmus / again.name).read_bytes() == again.read_bytes(), again.name


def test_time_stamps_are_fixed(fmus: Path) -> None:
    with zipfile.ZipFile(fmus / "Pid.fmu") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_binaries_contain_no_path_of_this_machine(fmus: Path, tmp_path: Path) -> None:
    cargo_home = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo"))
    for model in MODELS:
        binary = library(fmus, model, tmp_path).read_bytes()
        for path in (ROOT, Path.home(), cargo_home):
            assert os.fsencode(path) + b"/" not in binary, f"{model} contains {path}"


def test_a_prebuilt_binary_replaces_a_build(fmus: Path, tmp_path: Path) -> None:
    binary = library(fmus, "Source", tmp_path)
    out = tmp_path / "out"
    result = cargo_fmu("export", "Source", "--binary", f"linux64={binary}", "--out", out)
    assert result.returncode == 0, result.stderr
    with zipfile.ZipFile(out / "Source.fmu") as archive:
        assert archive.read("binaries/linux64/Source.so") == binary.read_bytes()


def test_the_error_for_an_unknown_model_lists_the_known_ones() -> None:
    message = refusal("export", "Pidd")
    assert '"Pidd"' in message
    assert all(model in message for model in MODELS)


def glibc_versions(binary: Path) -> set[tuple[int, ...]]:
    """Return the versions of glibc whose symbols a binary needs."""
    symbols = subprocess.run(
        ["objdump", "-T", binary], capture_output=True, text=True, check=True
    ).stdout
    found = re.findall(r"GLIBC_([0-9.]+)", symbols)
    return {tuple(map(int, version.split("."))) for version in found}


def test_portable_fmus_load_with_an_old_glibc(tmp_path: Path) -> None:
    portable = ROOT / "target" / "portable"
    assert portable.exists(), "run `make portable`"
    # One stands for all, which the same tools build.
    binary = library(portable, "Pid", tmp_path)
    assert max(glibc_versions(binary)) <= (2, 17)
    assert b"libgcc_s" not in binary.read_bytes()


@pytest.mark.parametrize("target", ["i686-unknown-linux-musl", "universal2-apple-darwin"])
def test_the_error_for_a_target_without_standard_library_gives_remedies(
    target: str, tmp_path: Path
) -> None:
    compiler = tmp_path / "rustc"  # without a standard library for any target
    real = shutil.which("rustc")
    compiler.write_text(f'#!/bin/sh\n[ "$1" = --print ] && echo /missing || exec {real} "$@"\n')
    compiler.chmod(0o755)
    tools = {"CARGO": shutil.which("cargo"), "RUSTC": str(compiler), "PATH": str(tmp_path)}
    environment = {**os.environ, **tools}
    program = ROOT / "target" / "debug" / "cargo-fmu"
    result = subprocess.run(
        [program, "export", "--target", target, "--out", tmp_path / "out"],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 1
    for remedy in ("rustup target add", "rustup component add rust-src", "rust-web-src"):
        assert remedy in result.stderr


def test_a_binary_of_another_model_or_format_is_rejected(fmus: Path, tmp_path: Path) -> None:
    source = library(fmus, "Source", tmp_path)
    out = ["--out", tmp_path / "out"]
    message = refusal("export", "Pid", "--binary", f"linux64={source}", *out)
    assert "does not contain the model Pid" in message
    message = refusal("export", "Source", "--binary", f"win64={source}", *out)
    assert "win64" in message
    message = refusal("export", "Source", "--binary", f"linux64={tmp_path / 'nothing.so'}", *out)
    assert "nothing.so" in message
    assert not list((tmp_path / "out").iterdir()), "nothing is half-written"


# --- variants -------------------------------------------------------------------------------------


def export_variant(folder: Path, *options: str) -> Path:
    """Export a variant to a folder and return its FMU."""
    result = cargo_fmu("export", *options, "--out", folder)
    assert result.returncode == 0, result.stderr
    (file,) = folder.iterdir()
    return file


def test_a_variant_has_other_start_values(fmus: Path, tmp_path: Path) -> None:
    settings = {"pid.kp": "400", "ts": "0.0005", "anti_windup": "true"}
    options = [f"--set={name}={value}" for name, value in settings.items()]
    file = export_variant(tmp_path / "variant", "Pid", "--name", "FastPid", *options)
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
        variant.slave.reset()
        variant.initialize(0.0)
        assert [variant.get(name) for name in ("pid.kp", "ts")] == [400.0, 0.0005]
    validate = cargo_fmu("validate", "--quick", file)
    assert "no error, no warning" in validate.stdout, validate.stdout
    # The base is unchanged.
    again = export_variant(tmp_path / "base", "Pid")
    assert again.read_bytes() == (fmus / "Pid.fmu").read_bytes()


def test_settings_that_cannot_be_used_are_refused(fmus: Path) -> None:
    for options, message in (
        (["--set", "pid.kp=-1"], "--set pid.kp=-1 cannot be used: expected a number from 0 to"),
        (["--name", "PidRbf"], "--name PidRbf: there is a model with this name"),
        (["Source", "--name", "Both"], "--name and --set need one model, but 2 are exported"),
    ):
        assert message in refusal("export", "Pid", *options)


# --- info -----------------------------------------------------------------------------------------


def test_info_shows_variables_capabilities_and_platforms(fmus: Path) -> None:
    text = cargo_fmu("info", fmus / "IpidRbf.fmu").stdout
    for pattern in (
        r"^model +IpidRbf$",
        r"^GUID +\{[0-9a-f-]{36}\}$",
        r"^experiment +start 0 s, stop 20 s, step 0.001 s$",
        r"^platforms +linux64$",
        r"^documents +documentation/index.html model.png$",
        r"^  canHandleVariableCommunicationStepSize +true$",
        r"^  r +input +continuous +Real +rad +0 +Set-point",
        r"^  pid.kp +parameter +tunable +Real +N/rad +300 +0 to 1e9 +Proportional",
        r"^  rbf.target +parameter +fixed +Enumeration +own +1 to 2 ",
    ):
        assert re.search(pattern, text, re.MULTILINE), pattern


# --- help and completions -------------------------------------------------------------------------


def complete(words: str, script: Path) -> list[str]:
    """Return what bash offers after `words`."""
    program = f"""
        source {script}
        COMP_WORDS=({words})
        [[ "{words}" == *" " ]] && COMP_WORDS+=("")
        COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
        _cargo_fmu_after_cargo cargo "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
        echo "${{COMPREPLY[@]}}"
    """
    bash = shutil.which("bash") or pytest.skip("no bash")
    return subprocess.run(
        [bash, "--norc", "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()


def test_bash_completes_after_cargo_fmu(tmp_path: Path) -> None:
    script = tmp_path / "completions.sh"
    script.write_text(cargo_fmu("completions", "bash").stdout)
    assert complete("cargo fmu ex", script) == ["export"]
    assert complete("cargo fmu export --ta", script) == ["--target"]
    assert complete("cargo bu", script) == []
