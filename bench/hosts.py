"""The FMUs that are measured, and the hosts in C and Rust that measure them."""

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path
from typing import Any, Self

import fmpy
from fmpy.model_description import ModelVariable

from pendulum_fmus.project import FMUS, PROGRAM, ROOT

BENCH = ROOT / "bench"
NATIVE = ROOT / "target" / "native" / "cargo-fmu"
BENCH_HOST = NATIVE.with_name("bench-host")
SOURCES = ROOT / "target" / "sources"

Costs = dict[str, list[float]]
"""Times in ns, one per round, by the name of what was measured: "cycle/Pid changing"."""


# --- the FMUs -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An FMU with its inputs, outputs and start values, for the C host: a table of cases.toml."""

    name: str
    model: str
    outputs: Sequence[str]
    inputs: Mapping[str, float | str | None] = field(default_factory=dict)
    """A constant, the output FMU.INDEX of another case, or None for a changing signal."""
    start: Mapping[str, float | bool] = field(default_factory=dict)

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> Self:
        """Return the case of a table, in which listed inputs change."""
        inputs = table.get("inputs", {})
        inputs = inputs if isinstance(inputs, Mapping) else dict.fromkeys(inputs)
        return cls(**{**table, "inputs": inputs})


TABLES = tomllib.loads((BENCH / "cases.toml").read_text(encoding="utf-8"))

REFERENCE, ALL_OUTPUTS = (Case.of(TABLES[key]) for key in ("reference", "all_outputs"))

MODELS = {table["name"]: Case.of(table) for table in TABLES["models"]}

LOOP, PAIR = (list(map(Case.of, TABLES[key])) for key in ("loop", "pair"))

BASELINE = replace(MODELS["PidRbf"], name="PidRbf, baseline", model="PidRbf_baseline")
"""The network without the vectors that are chosen at run time."""

CALL = replace(MODELS["Pid"], inputs={"y": None})
"""One input, a step and one output."""

LINEAR = list(MODELS.values())[:4]
"""The controllers and the linear plant."""

VERSIONS = [*LINEAR, ALL_OUTPUTS]
"""The cases that are compared with FMI 3.0."""

COMPILERS = {"cc": os.environ.get("CC", "cc"), "clang": "clang"}
"""The C compilers by their names on the page; those that are installed compile the FMUs in C."""

STANDING = {"r": 1.0, "y": 0.99, "d": 0.0, "u_supervisor": 10.0, "u": 1e-4}
"""Constant inputs. The force is so small that the plant stays upright."""


def standing(case: Case) -> Case:
    """Return a case with constant inputs."""
    return replace(case, inputs={name: STANDING[name] for name in case.inputs})


def in_fmi3(case: Case) -> Case:
    """Return a case with the FMU of FMI 3.0, which has whole arrays as outputs."""
    outputs = dict.fromkeys(name.partition("[")[0] for name in case.outputs)
    name, model = f"{case.name}, FMI 3.0", f"{case.model}_fmi3"
    return replace(case, name=name, model=model, outputs=list(outputs))


IN_C = [version for case in LINEAR for version in (case, in_fmi3(case))]
"""The cases whose FMUs are compiled from their C sources, too."""


def compiled(case: Case, compiler: str) -> Case:
    """Return a case with the FMU that a compiler makes of the C sources."""
    return replace(case, name=f"{case.name}, {compiler}", model=f"{case.model}_{compiler}")


# --- the hosts ----------------------------------------------------------------------------


class Host:
    """The C host of cycle.c in a folder, which unpacks the FMUs that it runs there."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.program = folder, folder / "cycle"
        compiler = os.environ.get("CC", "cc")
        libraries = ["-ldl", "-lm", "-lpthread"]
        run([compiler, "-O2", "-o", self.program, BENCH / "cycle.c", *libraries])
        run([sys.executable, ROOT / "examples" / "own-fmu" / "build.py", folder])
        self._unpacked: dict[str, tuple[list[str], dict[str, ModelVariable]]] = {}

    def measure(
        self, mode: str, count: int, repeats: int, cases: Sequence[Case], **env: str
    ) -> list[dict]:
        """Run a mode of the C host, which measures the cases in turn."""
        lines = run(self.command(mode, count, repeats, cases), env)
        return [json.loads(line) for line in lines.splitlines()]

    def command(self, mode: str, count: int, repeats: int, cases: Sequence[Case]) -> list[str]:
        """Return the command that runs a mode of the C host."""
        words = [str(self.program), mode, str(count), str(repeats)]
        for index, case in enumerate(cases):
            words += ["--"] * (index > 0) + self._words(case)
        return words

    def compile(self, case: Case, to: Case, compiler: str, level: str) -> None:
        """Compile the C sources of a case's FMU to the FMU of another case."""
        fmu, out = SOURCES / f"{case.model}.fmu", self.folder / f"{to.model}.fmu"
        options = {"CC": compiler, "CFLAGS": level}
        run([PROGRAM, "build", fmu, "--force", "--out", out], options)

    def _words(self, case: Case) -> list[str]:
        """Return the arguments that describe a case."""
        words, variables = self.unpack(case.model)

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

    def unpack(self, model: str) -> tuple[list[str], dict[str, ModelVariable]]:
        """Return the arguments from the version to the resources, and the variables."""
        if model in self._unpacked:
            return self._unpacked[model]
        own, folder = self.folder / f"{model}.fmu", self.folder / model
        fmpy.extract(own if own.exists() else FMUS / own.name, str(folder))
        description = fmpy.read_model_description(str(folder), validate=False)
        resources = folder / "resources"
        fmi, tuple_, place = 2, fmpy.platform, resources.as_uri()
        if description.fmiVersion.startswith("3"):
            fmi, tuple_, place = 3, fmpy.platform_tuple, f"{resources}{os.sep}"
        library = f"{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
        words = [f"fmi={fmi}", f"binary={folder / 'binaries' / tuple_ / library}"]
        words += [f"guid={description.guid}", *[f"resources={place}"] * resources.is_dir()]
        variables = {variable.name: variable for variable in description.modelVariables}
        self._unpacked[model] = words, variables
        return words, variables


def run(
    command: Sequence[object], env: Mapping[str, str] | None = None, given: str | None = None
) -> str:
    """Run a program with an input and return what it prints."""
    words, env = list(map(str, command)), {**os.environ, **(env or {})}
    options: Any = {"cwd": ROOT, "env": env, "input": given}
    result = subprocess.run(words, **options, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(f"{command[0]} failed:\n{result.stdout}{result.stderr}")
    return result.stdout


def in_host(rounds: int, cycles: int, words: Sequence[object]) -> Costs:
    """Return what bench/host.rs prints: the times in each round by name."""
    lines = run([BENCH_HOST, rounds, cycles, *words]).splitlines()
    return {
        name: list(map(float, times.split())) for name, times in (li.split("\t") for li in lines)
    }
