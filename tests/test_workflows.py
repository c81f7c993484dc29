"""The workflows for GitHub: they cannot run here, but what they name exists and parses."""

import functools
import hashlib
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from pages import ROOT
from test_exporter import cargo_fmu
from test_merge import WINDOWS, contents, pack, platforms

FOLDER = ROOT / ".github" / "workflows"
FILES = sorted(FOLDER.glob("*.yml"))
WORKFLOWS = {file.name: yaml.safe_load(file.read_text()) for file in FILES}
MAKEFILE = (ROOT / "Makefile").read_text()

SELDOM = {"sudo", "env"}
"""Words before a command that do not change what it is."""


def jobs() -> list:
    """Return all jobs, with their names."""
    return [
        pytest.param(job, id=f"{file}:{name}")
        for file, workflow in WORKFLOWS.items()
        for name, job in workflow["jobs"].items()
    ]


def variants(job: dict) -> list[dict]:
    """Return the values of a job's matrix, one for each machine."""
    matrix = job.get("strategy", {}).get("matrix", {})
    return matrix.get("include", [{}])


def commands() -> dict[str, list[str]]:
    """Return the commands of all steps, by their text."""
    found = {}
    for workflow in WORKFLOWS.values():
        for job in workflow["jobs"].values():
            for variant in variants(job):
                for step in job.get("steps", []):
                    text = re.sub(
                        r"\$\{\{ matrix\.(\w+) \}\}",
                        lambda match, variant=variant: str(variant.get(match[1], "")),
                        step.get("run", ""),
                    )
                    found |= {line: words(line) for line in text.splitlines() if line}
    return found


def words(command: str) -> list[str]:
    """Split a command, without what stands before it and where its output goes."""
    split = shlex.split(command.partition(" > ")[0])
    while split[0] in SELDOM or "=" in split[0]:
        split.pop(0)
    return split


COMMANDS = commands()


@functools.cache
def options_of(subcommand: str) -> set[str]:
    """Return the options that a subcommand of `cargo fmu` has."""
    result = cargo_fmu(subcommand, "--help")
    assert result.returncode == 0, subcommand
    return set(re.findall(r"(?<=[ ,])--?[a-z][\w-]*", result.stdout))


def test_the_three_workflows_are_there() -> None:
    assert WORKFLOWS.keys() == {"ci.yml", "fmus.yml", "release.yml"}
    assert len(COMMANDS) >= 10


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_known_and_names_what_exists(command: str) -> None:
    match COMMANDS[command]:
        case ["make", target]:
            assert re.search(rf"^{target}:", MAKEFILE, re.MULTILINE)
        case ["bash" | "python3", script, *_]:
            assert (ROOT / script).is_file()
        case ["cargo", "fmu", subcommand, *arguments]:
            given = {word for word in arguments if word.startswith("-")}
            assert given <= options_of(subcommand)
        case ["cargo", "test", "--locked"] | ["rustup", "target", "add", *_]:
            pass
        case ["python", "-m", "pip", "install", "--requirement", file]:
            assert (ROOT / file).is_file()
        case ["gh", "release", "create", *_]:
            pass
        case _:
            pytest.fail(f"nothing checks {command!r}")


def test_commands_of_the_makefile_and_of_scripts_are_known() -> None:
    scripts = [path.read_text() for path in (ROOT / ".ci").iterdir()]
    for text in (MAKEFILE, *scripts):
        for subcommand, rest in re.findall(r"^[^#\n]*\bcargo fmu (\w+)([^;\n]*)", text, re.M):
            given = re.findall(r"(?<= )--?[a-z][\w-]*", rest)
            assert set(given) <= options_of(subcommand), subcommand


def test_what_runs_on_every_system_is_there_and_pinned() -> None:
    script = (ROOT / ".ci" / "fmpy").read_text()
    tests = re.search(r"tests/test_\{([\w,]+)\}\.py", script)
    packages = re.search(r"--constraint (\S+) (.*)", script)
    assert tests
    assert packages
    assert all((ROOT / "tests" / f"test_{name}.py").is_file() for name in tests[1].split(","))
    pinned = re.findall(r"^([\w-]+)==", (ROOT / packages[1]).read_text(), re.MULTILINE)
    assert set(packages[2].split()) <= set(pinned)


@pytest.mark.parametrize("job", jobs())
def test_every_job_ends_in_time_or_is_a_workflow_of_ours(job: dict) -> None:
    if "uses" in job:
        assert (ROOT / job["uses"]).is_file()
    else:
        assert 0 < job["timeout-minutes"] <= 90


def test_only_publishing_may_write() -> None:
    for file, workflow in WORKFLOWS.items():
        assert workflow["permissions"] == {"contents": "read"}
        for name, job in workflow["jobs"].items():
            expected = {"contents": "write"} if name == "publish" else None
            assert job.get("permissions") == expected, (file, name)


def test_every_action_is_one_commit_with_its_version() -> None:
    versions: dict[str, set[str]] = {}
    for file in FILES:
        for used in re.findall(r"uses: (.*)", file.read_text()):
            if not used.startswith("./"):
                match = re.fullmatch(r"(actions/[\w-]+)@([0-9a-f]{40} # v\d+\.\d+\.\d+)", used)
                assert match, used
                versions.setdefault(match[1], set()).add(match[2])
    assert all(len(found) == 1 for found in versions.values()), versions


def test_zizmor_finds_nothing() -> None:
    """A checker of workflows: their form, permissions, what may be injected into them."""
    program = Path(sys.executable).with_name("zizmor")
    command = [program, "--offline", "--strict-collection", "--min-severity", "medium", FOLDER]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


# --- what they call -------------------------------------------------------------------------------


def test_make_merged_joins_what_the_machines_wrote(fmus: Path, tmp_path: Path) -> None:
    built, to = tmp_path / "built", tmp_path / "merged"
    for model in ("Pid", "Source"):
        files = contents(fmus / f"{model}.fmu")
        renamed = WINDOWS.replace("Pid", model)
        for system in ("linux", "windows"):
            (built / system).mkdir(parents=True, exist_ok=True)
        pack(built / "linux" / f"{model}.fmu", files)
        windows = {renamed if name.startswith("bin") else name: files[name] for name in files}
        pack(built / "windows" / f"{model}.fmu", windows)
    make = ["make", "--silent", "merged", f"BUILT={built}", f"MERGED={to}"]
    subprocess.run(make, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)

    sums = dict(reversed(line.split()) for line in (to / "SHA256SUMS").read_text().splitlines())
    assert sums.keys() == {"Pid.fmu", "Source.fmu"}
    for name, digest in sums.items():
        assert platforms(to / name) == ["linux64", "win64"]
        assert hashlib.sha256((to / name).read_bytes()).hexdigest() == digest

    (built / "windows" / "Pid.fmu").unlink()
    alone = subprocess.run(make, cwd=ROOT, check=False, capture_output=True, text=True)
    assert alone.returncode != 0
    assert "expected two or more" in alone.stderr


def release_notes(folder: Path, tag: str) -> subprocess.CompletedProcess[str]:
    """Run the check of a release in a folder with a manifest and a changelog."""
    return subprocess.run(
        [sys.executable, ROOT / ".ci" / "release_notes.py", tag],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def write_changelog(folder: Path, *sections: str) -> None:
    """Write a changelog, which begins with what is not released yet."""
    text = "\n\n".join(["# Changelog", "## Unreleased", "- new", *sections])
    (folder / "CHANGELOG.md").write_text(text + "\n")


def test_a_release_has_the_version_of_the_workspace_and_a_section(tmp_path: Path) -> None:
    (tmp_path / "Cargo.toml").write_text('[workspace.package]\nversion = "1.2.0"\n')
    write_changelog(tmp_path, "## 1.2.0 - 2026-01-31", "- this", "## 1.1.0 - 2026-01-01", "- old")
    notes = release_notes(tmp_path, "v1.2.0")
    assert (notes.returncode, notes.stdout) == (0, "- this\n")
    for tag in ("v1.2", "1.2.0", "v1.3.0"):
        assert "expected v1.2.0" in release_notes(tmp_path, tag).stderr
    for sections in (["## 1.1.0", "- old"], ["## 1.2.0", "## 1.1.0", "- old"], ["## 1.2.0-b", "-"]):
        write_changelog(tmp_path, *sections)
        notes = release_notes(tmp_path, "v1.2.0")
        assert notes.returncode == 1
        assert notes.stderr.startswith("error: CHANGELOG.md")


def test_the_version_of_this_workspace_is_found() -> None:
    version = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]
    said = release_notes(ROOT, f"v{version}")
    assert said.returncode == 0 or said.stderr.startswith("error: CHANGELOG.md"), said.stderr
