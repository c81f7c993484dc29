"""Writes docs/command-line.md and docs/parameters.md from the program and FMUs of `make fmus`."""

import json
import re
import subprocess
from operator import itemgetter

from pendulum_fmus.project import FMUS, PROGRAM, ROOT

BASES = {"Pendulum": None, "Source": None, "Pid": None, "PidRbf": "Pid", "IpidRbf": "PidRbf"}
"""The models, and for each another one whose variables it has, too."""

HEAD = ["Variable", "Kind", "Unit", "Start", "Range", "Description"]

COMMAND_LINE = """# The command line

Made from the help of the program by `docs/reference.py`; `cargo fmu COMMAND --help` prints a
section. These pages explain the commands: [package](package.md) and [platforms](platforms.md) for
`export` and `merge`, [changes](changes.md) for `diff`, [C sources](sources.md) for `build`,
[simulate](simulate.md) for `simulate` and `compare`, [sweeps](sweeps.md), [the
validator](validate.md), [SSP packages](ssp.md) and [containers](pack.md) for `pack`.
"""

PARAMETERS = """# Variables of the FMUs

Made by `docs/reference.py` from the FMUs for FMI 3.0. In FMI 2.0, an array is one variable for each
element, `rbf.w[1]` to `rbf.w[4]`, and the networks have four nodes. A tunable parameter may change
during a simulation, a fixed one only before it. `cargo fmu info` also shows local variables and
types.
"""


def command_line() -> str:
    """Return the page with the help of each command."""

    def help_of(*command: str) -> str:
        return subprocess.check_output([PROGRAM, *command, "--help"], encoding="utf-8")

    commands = re.findall(r"^  ([a-z]+) ", help_of().split("Commands:")[1], re.MULTILINE)
    sections = [COMMAND_LINE]
    for command in commands:
        if command != "help":
            about, _, text = help_of(command).partition("\n\n")
            sections.append(f"## {command}\n\n{about}.\n\n```text\n{text.strip()}\n```\n")
    return "\n".join(sections)


def written(value: object) -> str:
    """Return a value as a user writes it; nothing for none."""
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(map(written, value))
    return f"{value:g}" if isinstance(value, float) else str(value).lower()


def row(variable: dict, enumerations: dict[str, dict[str, int]]) -> list[str]:
    """Return the cells of a variable."""
    name, kind, start = variable["name"], variable["causality"], variable["start"]
    if kind.lower().endswith("parameter"):
        kind = f"{variable['variability']} {kind.replace('structuralP', 'structural p')}"
    items = enumerations.get(variable["declaredType"])
    if items:
        start = next((item for item, value in items.items() if value == start), None)
        span = ", ".join(
            f"{value}: `{item}`" for item, value in sorted(items.items(), key=itemgetter(1))
        )
    else:
        span = " to ".join(filter(None, map(written, [variable["min"], variable["max"]])))
    elements = "".join(f"[{size}]" for size in variable["dimensions"])
    unit = variable["unit"] or ""
    return [f"`{name}{elements}`", kind, unit, written(start), span, variable["description"]]


def parameters() -> str:
    """Return the page with the variables of each FMU, except those of its base."""
    tables: dict[str, list[list[str]]] = {}
    sections = [PARAMETERS]
    for model, base in BASES.items():
        command = [PROGRAM, "info", "--json", FMUS / f"{model}_fmi3.fmu"]
        info = json.loads(subprocess.check_output(command))
        tables[model] = [
            row(variable, info["enumerations"])
            for variable in info["variables"]
            if variable["causality"] not in {"independent", "local"}
        ]
        common = tables[base] if base else []
        assert all(cells in tables[model] for cells in common)
        own = [cells for cells in tables[model] if cells not in common]
        lines = "".join(f"| {' | '.join(cells)} |\n" for cells in [HEAD, ["---"] * len(HEAD), *own])
        about = f"{info['modelDescription']['description']}."
        about += f" It has the variables of `{base}`, and:" if base else ""
        sections.append(f"## {model}\n\n{about}\n\n{lines}")
    return "\n".join(sections)


if __name__ == "__main__":
    (ROOT / "docs" / "command-line.md").write_text(command_line(), encoding="utf-8")
    (ROOT / "docs" / "parameters.md").write_text(parameters(), encoding="utf-8")
