"""Parameter sweeps with the native master."""

import csv
import math
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from ...master import MasterError
from ...project import PROGRAM, ROOT

EXAMPLES = ROOT / "examples" / "closed-loop"

SYSTEMS = {
    "PID": "pid",
    "PID-RBF": "pid-rbf",
    "IPID-RBF": "supervised",
    "IPID-RBF own": "ipid-rbf",
}
"""The example system of each controller's loop, as in Table 1."""


def both_plants(kind: str, variable: str) -> list[str]:
    """Return the full names of a plant parameter in all plants of a loop."""
    plants = ["plant", "supervisor_plant"] if kind == "IPID-RBF" else ["plant"]
    return [f"{plant}.{variable}" for plant in plants]


def sweep(
    kind: str, variables: list[str], values: np.ndarray, settings: dict, limit: float, fmus: Path
) -> dict[str, np.ndarray]:
    """Run the step response of a controller for each value of some variables.

    Parameters
    ----------
    kind
        Key of SYSTEMS.
    variables, values
        The variables, which all get the same value, and their values, shape (n,).
    settings
        Start values for all runs, by full name.
    limit
        |e| above which a run has diverged [rad].
    fmus
        Folder of the FMUs.

    Returns
    -------
    The metrics by name, each of shape (n,); NaN where a run has no value.
    """
    if not PROGRAM.is_file():
        raise MasterError(f"{PROGRAM} does not exist; run `make fmus` first")
    with tempfile.TemporaryDirectory(prefix="sweep-") as name:
        folder = Path(name)
        text = (EXAMPLES / f"{SYSTEMS[kind]}.toml").read_text(encoding="utf-8")
        text = text.replace("../../target/fmu", str(fmus.resolve()))
        (folder / "system.toml").write_text(text, encoding="utf-8")
        table, out = folder / "sweep.toml", folder / "out.csv"
        table.write_text(_toml(variables, values, settings, limit), encoding="utf-8")
        command = [PROGRAM, "sweep", table, "--out", out]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode:
            raise MasterError(f"the sweep of {kind} failed: {run.stderr.strip()}")
        with out.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name != "failure"]
    return {name: np.array([_number(row[name]) for row in rows]) for name in names}


def _toml(variables: list[str], values: np.ndarray, settings: dict, limit: float) -> str:
    def quoted(value: float | str) -> str:
        return f'"{value}"' if isinstance(value, str) else repr(float(value))

    fixed = ", ".join(f'"{name}" = {quoted(value)}' for name, value in settings.items())
    names = ", ".join(f'"{name}"' for name in variables)
    numbers = ", ".join(repr(float(value)) for value in values)
    return (
        f'system = "system.toml"\nset = {{ {fixed} }}\n'
        f"[[parameter]]\nvariables = [{names}]\nvalues = [{numbers}]\n"
        '[signals]\nreference = "source.r"\noutput = "plant.theta"\n'
        'error = "controller.e"\ncontrol = "controller.u"\n'
        f"[metrics]\nlimit = {limit!r}\n"
    )


def _number(text: str) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    return float(text) if text else math.nan
