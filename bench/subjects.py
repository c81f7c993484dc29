"""The FMUs that are measured, and the programs that step them."""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from math import prod
from pathlib import Path

import fmpy
from fmpy.model_description import ModelVariable

from pendulum_fmus.project import FMUS, ROOT

BENCH = ROOT / "bench"


@dataclass(frozen=True)
class Case:
    """An FMU with its inputs, outputs and start values, for the C host."""

    name: str
    model: str
    inputs: Mapping[str, float | str | None] = field(default_factory=dict)
    """A constant, the output FMU.INDEX of another case, or None for a signal that moves."""
    outputs: Sequence[str] = ("u",)
    start: Mapping[str, float | bool] = field(default_factory=dict)


STANDING = {"r": 1.0, "y": 0.99, "d": 0.0, "u_supervisor": 10.0, "u": 1e-4}
"""Inputs that stand. The force is so small that the plant stays upright."""

CONTROLLER = dict.fromkeys(["r", "y", "d"])
FORCE = {"u": None}
SINE = {"signal": 2}

TRANSFER_FUNCTION, LINEAR, NONLINEAR = ({"model": item} for item in (1, 2, 3))
"""The items of the plant's enumeration."""

REFERENCE = Case("bare PID in C", "CPid", CONTROLLER)

MODELS = [
    Case("Pid", "Pid", CONTROLLER),
    Case("PidRbf", "PidRbf", CONTROLLER),
    Case("IpidRbf", "IpidRbf", {**CONTROLLER, "u_supervisor": None}),
    Case("Pendulum, linear", "Pendulum", FORCE, ["theta"], LINEAR),
    Case("Pendulum, nonlinear", "Pendulum", FORCE, ["theta"], NONLINEAR),
    Case("Pendulum, transfer function", "Pendulum", FORCE, ["theta"], TRANSFER_FUNCTION),
]
"""The FMUs of the project with inputs; all move."""

ALL_OUTPUTS = Case(
    "PidRbf, all outputs",
    "PidRbf",
    CONTROLLER,
    ["u", "u_p", "e", "u_n", *(f"rbf.{x}[{i}]" for x in "wh" for i in range(1, 5))],
)
"""The outputs of the network are arrays in FMI 3.0."""

VERSIONS = [*MODELS[:4], ALL_OUTPUTS]
"""The cases that are compared with FMI 3.0."""

SOURCE = Case("Source", "Source", {}, ["r", "d"])

LOOP = [
    Case(
        "controller",
        "PidRbf",
        {"r": "source.0", "y": "plant.0", "d": "source.1"},
        ["u", "e"],
        {"previous_sample_terms": True},
    ),
    Case("plant", "Pendulum", {"u": "controller.0"}, ["theta"]),
    replace(SOURCE, name="source"),
]
"""examples/closed-loop/pid-rbf.toml."""

PAIR = [
    Case("controller", "PidRbf", {"y": "plant.0"}, ["u", "e"], {"r": 0.01}),
    Case("plant", "Pendulum", {"u": "controller.0"}, ["theta"]),
]
"""bench/coupled.toml."""


def by_name(name: str) -> Case:
    """Return a case of the project's FMUs."""
    return next(case for case in MODELS if case.name == name)


def standing(case: Case) -> Case:
    """Return a case with all inputs standing."""
    return replace(case, inputs={name: STANDING[name] for name in case.inputs})


def in_fmi3(case: Case) -> Case:
    """Return a case with the FMU of FMI 3.0, which has whole arrays as outputs."""
    outputs = dict.fromkeys(name.partition("[")[0] for name in case.outputs)
    name, model = f"{case.name}, FMI 3.0", f"{case.model}_fmi3"
    return replace(case, name=name, model=model, outputs=list(outputs))


def alone(case: Case) -> Case:
    """Return a case of a loop with signals instead of its connections."""
    return replace(case, inputs=dict.fromkeys(case.inputs))


# --- the C host ---------------------------------------------------------------------------


class Host:
    """The C host of cycle.c in a folder, which unpacks the FMUs that it runs there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.program = folder / "cycle"
        compiler = os.environ.get("CC", "cc")
        libraries = ["-ldl", "-lm", "-lpthread"]
        run([compiler, "-O2", "-o", self.program, BENCH / "cycle.c", *libraries])
        self._files = {file.stem: file for file in FMUS.glob("*.fmu")}
        run([sys.executable, ROOT / "examples" / "own-fmu" / "build.py", folder])
        self._files["CPid"] = folder / "CPid.fmu"
        self._unpacked: dict[str, tuple[list[str], dict[str, ModelVariable]]] = {}

    def build_python_fmu(self) -> bool:
        """Build the FMU of PythonFMU; return false if it cannot run here."""
        if not python_library() or not find_spec("pythonfmu"):
            return False
        script = BENCH / "python_pid.py"
        run([sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", self.folder])
        self._files["PythonPid"] = self.folder / "PythonPid.fmu"
        return True

    def measure(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[dict]:
        """Run a mode of the C host, which measures the cases in turn."""
        in_python = any(case.model == "PythonPid" for case in cases)
        command = self.command(mode, count, repeats, cases)
        lines = run(command, python_environment() if in_python else {})
        return [json.loads(line) for line in lines.splitlines()]

    def command(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[str]:
        """Return the command that runs a mode of the C host."""
        words = [str(self.program), mode, str(count), str(repeats)]
        for index, case in enumerate(cases):
            words += ["--"] * (index > 0) + self._words(case)
        return words

    def _words(self, case: Case) -> list[str]:
        """Return the arguments that describe a case."""
        if case.model not in self._unpacked:
            self._unpacked[case.model] = unpacked(self._files[case.model], self.folder)
        words, variables = self._unpacked[case.model]

        def reference(name: str) -> str:
            shape = variables[name].shape
            elements = f":{prod(shape)}" if shape else ""
            return f"{variables[name].valueReference}{elements}"

        words = [f"name={case.name}", *words]
        for name, value in case.inputs.items():
            words.append(f"in={reference(name)}" + (f":{value}" if value is not None else ""))
        words += [f"out={reference(name)}" for name in case.outputs]
        types = {"Real": "real", "Float64": "real", "Boolean": "boolean"}
        for name, value in case.start.items():
            kind = types.get(variables[name].type, "integer")
            words.append(f"{kind}={reference(name)}:{float(value)}")
        return words


def unpacked(file: Path, folder: Path) -> tuple[list[str], dict[str, ModelVariable]]:
    """Unpack an FMU; return arguments of the host, from the version to the resources; variables."""
    folder = folder / file.stem
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    description = fmpy.read_model_description(str(folder), validate=False)
    identifier = description.coSimulation.modelIdentifier
    resources = folder / "resources"
    if description.fmiVersion.startswith("3"):
        fmi, platform, place = 3, fmpy.platform_tuple, f"{resources}{os.sep}"
    else:
        fmi, platform, place = 2, fmpy.platform, resources.as_uri()
    binary = folder / "binaries" / platform / f"{identifier}{fmpy.sharedLibraryExtension}"
    words = [f"fmi={fmi}", f"binary={binary}", f"guid={description.guid}"]
    words += [f"resources={place}"] if resources.is_dir() else []
    return words, {variable.name: variable for variable in description.modelVariables}


def python_library() -> Path | None:
    """Return the shared library of this Python, which PythonFMU's binary needs; None if missing."""
    folder, name = map(sysconfig.get_config_var, ("LIBDIR", "INSTSONAME"))
    library = Path(folder or "", name or "")
    return library if library.is_file() and ".so" in library.name else None


def python_environment() -> dict[str, str]:
    """Return an environment in which PythonFMU's binary finds this Python."""
    return {
        "LD_PRELOAD": str(python_library()),
        "PYTHONHOME": sys.base_prefix,
        "PYTHONPATH": sysconfig.get_path("purelib"),
    }


# --- programs -----------------------------------------------------------------------------


def run(command: Sequence[str | Path], env: Mapping[str, str] | None = None) -> str:
    """Run a program and return what it prints."""
    result = subprocess.run(
        list(map(str, command)),
        cwd=ROOT,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SystemExit(f"{command[0]} failed:\n{result.stdout}{result.stderr}")
    return result.stdout
