"""Run one closed loop of the paper from its FMUs: `python -m pendulum_fmus.run --help`."""

import argparse
import math
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelVariable

from . import loop
from .loop import PREVIOUS_SAMPLE_TERMS, SETTLING_BAND, TS, Loop, settling_time
from .master import ORDERS, MasterError, simulate

EXAMPLES = """\
examples:
  %(prog)s
      step response of the IPID-RBF controller with its own u as target
  %(prog)s --controller Pid --signal square --disturbance 1 --csv pid.csv
      row 6 of the paper's Table 1, with every sample
  %(prog)s --controller IpidRbf --target supervisor --signal sine
      row 3: IPID-RBF with a PID-RBF loop as supervisor
  %(prog)s --order parallel --step 0.00025 --plant-model nonlinear
      parallel order as in most tools, four steps per sample, nonlinear pendulum
  %(prog)s --fmi3 plant --controller PidRbf
      the plant is an FMU of FMI 3.0, the others are of FMI 2.0
  %(prog)s --set controller.rbf.eta=0.5 --set plant.M=2
      other parameters; `cargo fmu info FILE` lists the parameters of an FMU

A negative number in scientific notation needs an equals sign: --disturbance=-1e-3
"""

MAX_STEPS = 10**7
"""Maximum number of steps; more are assumed to be a mistake in `step` or `stop`."""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = loop.parser(
        "run",
        "Run one closed loop of the paper from its FMUs, coupled with FMPy.",
        epilog=EXAMPLES,
    )
    add = parser.add_argument
    # fmt: off
    add("--controller", choices=[*PREVIOUS_SAMPLE_TERMS], default="IpidRbf",
        help="FMU that controls the pendulum (default: %(default)s)")
    add("--target", choices=["own", "supervisor"], default="own",
        help="training target of IpidRbf's network: its own u, or the u of a second PID-RBF loop,"
        " as in Table 1 (default: %(default)s)")
    add("--signal", choices=["step", "sine", "square"], default="step",
        help="reference, amplitude 1 rad; sine has 0.2 Hz, square 0.1 Hz (default: %(default)s)")
    add("--disturbance", type=float, default=0.0, metavar="AMPLITUDE",
        help="added to the measured angle from 5 s to 5.5 s [rad] (default: 0)")
    add("--plant-model", choices=["linear", "nonlinear", "transfer_function"], default="linear",
        help="model of the pendulum (default: %(default)s)")
    add("--order", choices=ORDERS, default="sequential",
        help="sequential: controller first, u acts immediately; parallel: all step together, u acts"
        " one step later (default: %(default)s)")
    add("--step", type=float, default=TS, metavar="H",
        help="communication step [s] (default: %(default)s)")
    add("--start", type=float, default=TS, metavar="T",
        help="start time [s] (default: %(default)s, the paper's k = 1)")
    add("--stop", type=float, default=20.0, metavar="T",
        help="time of the last communication point [s] (default: %(default)s)")
    add("--previous-sample-terms", choices=["auto", "on", "off"], default="auto",
        help="whether u(k) uses the PID terms of sample k-1. auto: in sequential order as in the"
        " paper's Table 1 (on for Pid and PidRbf); in parallel order off, since the master already"
        " delays by one sample, and a second delay is too much for the network")
    add("-w0", type=float, nargs=4, metavar="W", help="initial weights of the network [N]")
    add("--supervisor-w0", type=float, nargs=4, metavar="W",
        help="initial weights of the supervisor's network [N]")
    add("--fmi3", nargs="*", metavar="COMPONENT",
        help="take the FMI 3.0 FMUs of these components, or of all if none is named; FMUs of both"
        " versions can be coupled")
    add("--set", dest="overrides", action="append", default=[], type=_assignment,
        metavar="COMPONENT.VARIABLE=VALUE",
        help="set the start value of a parameter; may be repeated. Components: controller, plant,"
        " source, and with --target supervisor also supervisor, supervisor_plant")
    add("--csv", type=Path, metavar="FILE", help="write the time and all outputs to this file")
    # fmt: on
    return parser


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (equals and "." in name):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form component.variable=value")
    return name, value


def steps_until(stop: float, start: float, step: float) -> int:
    """Return the number of communication points start + k step up to `stop` [s]."""
    if not (math.isfinite(start) and math.isfinite(stop) and stop >= start):
        raise MasterError(f"the stop time {stop} s is before the start time {start} s")
    if not 0 < step < math.inf:
        raise MasterError(f"the step {step} s is not a positive number")
    steps = (stop - start) / step
    if steps > MAX_STEPS:
        raise MasterError(f"{steps:.3g} steps are too many; at most {MAX_STEPS} are allowed")
    return math.floor(steps + 1e-6) + 1


def loop_of(options: argparse.Namespace) -> Loop:
    """Return the loop that the options describe; they are named like its fields."""
    values = {f.name: vars(options)[f.name] for f in fields(Loop) if f.name in options}
    late = options.previous_sample_terms
    automatic = None if options.order == "sequential" else False
    values["previous_sample_terms"] = automatic if late == "auto" else late == "on"
    values["fmi3"] = () if options.fmi3 is None else tuple(options.fmi3) or ("all",)
    return Loop(**values)


def run(options: argparse.Namespace) -> bool:
    """Run the loop of the command line and print a summary."""
    steps = steps_until(options.stop, options.start, options.step)
    with loop_of(options).system(options.fmus) as system:
        results = simulate(
            system, options.start, options.step, steps, order=options.order, progress=True
        )
        if options.csv:
            located = map(system.locate, list(results)[1:])
            units = (unit(component.variable(name)) for component, name in located)
            write_csv(options.csv, results, ["s", *units])
    print(summary(results, options.signal))
    if options.csv:
        print(f"wrote {options.csv}: {steps} row{'s' * (steps != 1)}")
    return True


def unit(variable: ModelVariable) -> str:
    """Return the unit of a variable, "" if it has none."""
    return variable.unit or getattr(variable.declaredType, "unit", None) or ""


def write_csv(path: Path, results: Mapping[str, np.ndarray], units: Iterable[str]) -> None:
    """Write one column per variable, "plant.theta [rad]", and numbers that read back exactly.

    A file is replaced once it is complete; a device is written to.
    """
    pairs = zip(results, units, strict=True)
    head = ",".join(f"{name} [{unit}]" if unit else name for name, unit in pairs)
    columns = [column.tolist() for column in results.values()]
    rows = [",".join(map(repr, row)) for row in zip(*columns, strict=True)]
    special, target = path.exists() and not path.is_file(), path.resolve()
    file = path if special else target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        file.write_text("\n".join([head, *rows, ""]), encoding="utf-8", newline="\n")
        if not special:
            file.replace(target)
    except OSError as error:
        if not special:
            file.unlink(missing_ok=True)
        raise MasterError(f"{path} cannot be written: {error.strerror}") from error


def summary(results: Mapping[str, np.ndarray], signal: str) -> str:
    """Summarize the performance of the controller in a few lines."""
    time, error = results["time"], results["controller.e"]
    lines = [
        f"final e         {error[-1]:.9e} rad at t = {time[-1]:.10g} s",
        f"maximum |u|     {np.max(np.abs(results['controller.u'])):.9g} N",
    ]
    if signal == "step":
        # On a step, the band is relative to the reference
        band = SETTLING_BAND * abs(results["source.r"][-1])
        settled = settling_time(time, error, band)
        text = "never" if math.isnan(settled) else f"{settled:.10g} s"
        lines.insert(1, f"settling time   {text} (band of ±{SETTLING_BAND:.1%})")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; return its exit status."""
    return loop.finish(parser(), run, arguments)


if __name__ == "__main__":
    sys.exit(main())
