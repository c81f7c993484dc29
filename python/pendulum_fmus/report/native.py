"""Loops and sweeps with the native master, which computes the same bits as FMPy's, but faster."""

import csv
import json
import math
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from multiprocessing.pool import Pool
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ..loop import TS, Columns, Loop, cost
from ..master import MasterError
from ..project import PROGRAM, SENSOR

RECORDED = {
    "Pid": ("e", "u", "u_p"),
    "PidRbf": ("e", "u", "u_p", "u_n"),
    "IpidRbf": ("e", "u", "u_p", "u_n"),
    "Pendulum": ("theta", "x"),
    "Source": ("r", "d"),
    "Sensor": ("y",),
}
"""The outputs that `simulate` records, by FMU."""

SYSTEMS = {
    "PID": Loop("Pid"),
    "PID-RBF": Loop("PidRbf"),
    "IPID-RBF": Loop("IpidRbf", target="supervisor"),
    "IPID-RBF own": Loop("IpidRbf"),
}
"""The step response of each controller, as in Table 1."""


def simulate_all(
    loops: Iterable[Loop],
    fmus: Path,
    pool: Pool,
    *,
    only: Sequence[str] = (),
    last: int = 0,
    may_diverge: bool = False,
) -> dict[Loop, Columns]:
    """Simulate many loops with a pool; return the columns of each as `simulate` does."""
    ordered = sorted(loops, key=cost, reverse=True)
    run = partial(simulate, fmus=fmus, only=only, last=last, may_diverge=may_diverge)
    bar = tqdm(pool.imap(run, ordered), total=len(ordered), unit="loop", leave=False, disable=None)
    return dict(zip(ordered, bar, strict=True))


def simulate(
    loop: Loop,
    fmus: Path,
    *,
    only: Sequence[str] = (),
    last: int = 0,
    may_diverge: bool = False,
) -> dict[str, np.ndarray]:
    """Simulate a loop at 1 ms, from the paper's k = 1.

    Parameters
    ----------
    loop
        The loop.
    fmus
        Folder of the FMUs.
    only
        Outputs to record of those in RECORDED; by default all.
    last
        Number of samples to return, the last ones; 0 for all.
    may_diverge
        Whether a loop that diverges has no columns, instead of raising an error.

    Returns
    -------
    The columns "time" and RECORDED by full name, each of shape (steps,) or (last,).
    """
    names = [
        f"{name}.{output}"
        for name, fmu in loop.models().items()
        for output in RECORDED[fmu]
        if not only or output in only
    ]
    with tempfile.TemporaryDirectory(prefix="loop-") as folder:
        system = Path(folder) / "system.toml"
        system.write_text(_system(loop, fmus, names), encoding="utf-8")
        try:
            # Rather than a file, which would have to reach the disk; a summary follows the rows
            text = _run(repr(loop), "simulate", system, "--csv", "/dev/stdout")
        except MasterError as error:
            if may_diverge and "the simulation diverges" in str(error):
                return {}
            raise
    lines = text.split("\n", loop.steps + 1)[1:-1]
    rows = np.loadtxt(lines[-last:], delimiter=",", ndmin=2)
    return dict(zip(["time", *names], np.ascontiguousarray(rows.T), strict=True))


def both_plants(kind: str, variable: str) -> list[str]:
    """Return the full names of a plant parameter in all plants of a loop."""
    models = SYSTEMS[kind].models().items()
    return [f"{name}.{variable}" for name, model in models if model == "Pendulum"]


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
    with tempfile.TemporaryDirectory(prefix="sweep-") as name:
        folder = Path(name)
        table, out = folder / "sweep.toml", folder / "out.csv"
        (folder / "system.toml").write_text(_system(SYSTEMS[kind], fmus), encoding="utf-8")
        table.write_text(_table(variables, values, settings, limit), encoding="utf-8")
        _run(f"the sweep of {kind}", "sweep", table, "--out", out)
        with out.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name != "failure"]
    return {name: np.array([_number(row[name]) for row in rows]) for name in names}


def _run(what: str, *arguments: str | Path) -> str:
    """Run the program; return what it prints."""
    if not PROGRAM.is_file():
        raise MasterError(f"{PROGRAM} does not exist; run `make fmus` first")
    run = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, check=False)
    if run.returncode:
        raise MasterError(f"{what}: {run.stderr.strip().removeprefix('error: ')}")
    return run.stdout


# --- files --------------------------------------------------------------------------------------


def _system(loop: Loop, fmus: Path, outputs: Sequence[str] = ()) -> str:
    """Return the file of a system; without `outputs` it records all."""
    settings = {
        "start": TS,
        "stop": TS * loop.steps,
        "step": TS,
        "order": loop.order,
        "connections": [f"{output} -> {input_}" for output, input_ in loop.connections()],
    }
    if outputs:
        settings["outputs"] = outputs
    lines = [f"{key} = {_toml(value)}" for key, value in settings.items()]
    starts = loop.starts()
    for name, model in loop.models().items():
        component = {"name": name, "fmu": str(_fmu(model, fmus)), "start": starts[name]}
        lines += ["[[component]]", *(f"{key} = {_toml(part)}" for key, part in component.items())]
    return "\n".join(lines)


def _fmu(model: str, fmus: Path) -> Path:
    """Return the absolute path of an FMU, which exists."""
    path, command = fmus / f"{model}.fmu", "cargo fmu export"
    if model == "Sensor":
        path, command = SENSOR, "make fmus"
    if not path.is_file():
        raise MasterError(f"{path} does not exist; run `{command}` first")
    return path.resolve()


def _table(variables: list[str], values: np.ndarray, settings: dict, limit: float) -> str:
    """Return the file of a sweep."""
    return (
        f'system = "system.toml"\nset = {_toml(settings)}\n'
        f"[[parameter]]\nvariables = {_toml(variables)}\nvalues = {_toml(values.tolist())}\n"
        '[signals]\nreference = "source.r"\noutput = "plant.theta"\n'
        'error = "controller.e"\ncontrol = "controller.u"\n'
        f"[metrics]\nlimit = {limit!r}\n"
    )


def _toml(value: Any) -> str:
    """Format a value as TOML, which except for tables is JSON."""
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{json.dumps(key)} = {_toml(part)}" for key, part in value.items())
        return f"{{ {pairs} }}"
    return json.dumps(value)


def _number(text: str) -> float:
    if text in ("true", "false"):
        return float(text == "true")
    return float(text) if text else math.nan
