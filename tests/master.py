"""Couple FMI 2.0 co-simulation FMUs by FMPy, at a fixed communication step.

As a module it couples any FMUs, by name:

    with System(
        [
            Component("controller", "target/fmu/Pid.fmu", sampled=True),
            Component("plant", "target/fmu/Pendulum.fmu", {"theta0": 0.1}),
        ],
        [("plant.theta", "controller.y"), ("controller.u", "plant.u")],
    ) as system:
        results = simulate(system, start=0.001, step=0.001, steps=5000)

As a script it runs one closed loop of the paper; see `python tests/master.py --help`.

Two orders of stepping are offered. At every communication point t

- sequential (Gauss-Seidel): one component after another fetches its inputs from the newest
  outputs and steps. With the controller first, the plant feels u(t) at t: no delay;
- parallel (Jacobi): all outputs are read, all inputs are set, then all components step.
  The plant feels u(t) one step later. Most tools do this.
"""

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from coupling import ORDERS, Component, MasterError, Reals, System, simulate, steps_until

__all__ = [
    "FMUS",
    "ORDERS",
    "TS",
    "Component",
    "MasterError",
    "Reals",
    "System",
    "closed_loop",
    "settling_time",
    "simulate",
    "steps_until",
]

FMUS = Path(__file__).resolve().parent.parent / "target" / "fmu"
"""Where `cargo fmu export` writes the FMUs."""

TS = 0.001
"""Sample time of the paper's controllers [s]."""

FREQUENCY = {"sine": 0.2, "square": 0.1}
"""Frequencies of the paper's signals [Hz]."""

PREVIOUS_SAMPLE_TERMS = {"Pid": True, "PidRbf": True, "IpidRbf": False}
"""Whether u(k) uses the PID terms of sample k-1, as in the paper's Table 1."""

SETTLING_BAND = 0.003
"""Half the width of the band in which a step response counts as settled, relative to the step."""
# --- the paper's loop ---------------------------------------------------------------------------


def closed_loop(
    controller: str,
    signal: str = "step",
    disturbance: float = 0.0,
    *,
    target: str = "own",
    plant_model: str = "linear",
    w0: Sequence[float] | None = None,
    supervisor_w0: Sequence[float] | None = None,
    previous_sample_terms: bool | None = None,
    overrides: Mapping[str, Any] | None = None,
    fmus: str | os.PathLike = FMUS,
) -> System:
    """Build the paper's loop: `source`, `controller` and `plant`.

    With the target "supervisor" a PID-RBF loop, `supervisor` and `supervisor_plant`, runs
    beside it, and its u is what the network of `controller` learns.

    Parameters
    ----------
    controller
        "Pid", "PidRbf" or "IpidRbf".
    signal
        "step", "sine" (0.2 Hz) or "square" (0.1 Hz), amplitude 1 rad.
    disturbance
        What is added to the measured angle from 5 s to 5.5 s [rad].
    target
        What the network of IpidRbf learns: its "own" u, or the "supervisor"'s.
    plant_model
        "linear", "nonlinear" or "transfer_function".
    w0, supervisor_w0
        Initial weights of the two networks [N], shape (4,).
    previous_sample_terms
        Whether the controllers use the PID terms of the sample before; by default as in the
        paper's Table 1 (Pid and PidRbf do, IpidRbf does not).
    overrides
        Further start values by full name: {"plant.model": "nonlinear"}.
    fmus
        The folder that the FMUs are in.
    """
    if controller not in PREVIOUS_SAMPLE_TERMS:
        raise MasterError(f"there is no controller {controller!r}")
    supervised = target == "supervisor"
    if supervised and controller != "IpidRbf":
        raise MasterError(f"{controller} has no target {target!r}, only IpidRbf has")
    models = {"controller": controller, "plant": "Pendulum", "source": "Source"}
    if supervised:
        models = {"supervisor": "PidRbf", "supervisor_plant": "Pendulum", **models}

    starts: dict[str, dict[str, Any]] = {name: {} for name in models}
    starts["source"] |= {"signal": signal, "disturbance.amplitude": disturbance}
    if signal in FREQUENCY:
        starts["source"]["frequency"] = FREQUENCY[signal]
    if controller == "IpidRbf":
        starts["controller"]["rbf.target"] = target
    for name, model in models.items():
        if model == "Pendulum":
            starts[name]["model"] = plant_model
        elif model != "Source":
            default = PREVIOUS_SAMPLE_TERMS[model]
            starts[name]["previous_sample_terms"] = (
                default if previous_sample_terms is None else previous_sample_terms
            )
    _add_weights(starts, "controller", w0)
    _add_weights(starts, "supervisor", supervisor_w0)
    _add_overrides(starts, overrides or {})
    return _build(models, starts, _connections(supervised), Path(fmus))


def _add_weights(starts: dict[str, dict], component: str, w0: Sequence[float] | None) -> None:
    if w0 is None:
        return
    if component not in starts:
        raise MasterError(f"there is no {component} to give initial weights to")
    starts[component] |= {f"rbf.w0[{j}]": weight for j, weight in enumerate(w0, start=1)}


def _add_overrides(starts: dict[str, dict], overrides: Mapping[str, Any]) -> None:
    for name, value in overrides.items():
        component, _, variable = name.partition(".")
        if component not in starts:
            known = ", ".join(starts)
            raise MasterError(f"{name}: there is no component {component!r}, only {known}")
        starts[component][variable] = value


def _connections(supervised: bool) -> list[tuple[str, str]]:
    def loop(controller: str, plant: str) -> list[tuple[str, str]]:
        return [
            ("source.r", f"{controller}.r"),
            ("source.d", f"{controller}.d"),
            (f"{plant}.theta", f"{controller}.y"),
            (f"{controller}.u", f"{plant}.u"),
        ]

    connections = loop("controller", "plant")
    if supervised:
        connections += loop("supervisor", "supervisor_plant")
        connections.append(("supervisor.u", "controller.u_supervisor"))
    return connections


def _build(
    models: Mapping[str, str],
    starts: Mapping[str, Mapping[str, Any]],
    connections: Sequence[tuple[str, str]],
    fmus: Path,
) -> System:
    """Instantiate the models; if one fails, those before it are freed."""
    with ExitStack() as stack:
        components = [
            stack.enter_context(
                Component(
                    name,
                    fmus / f"{model}.fmu",
                    starts[name],
                    sampled=model in PREVIOUS_SAMPLE_TERMS,
                )
            )
            for name, model in models.items()
        ]
        system = System(components, connections)
        stack.pop_all()
    return system


def settling_time(time: np.ndarray, error: np.ndarray, band: float = SETTLING_BAND) -> float:
    """Return the time [s] from which on |error| stays within `band`; NaN if it never does.

    `time` and `error` are of shape (steps,), `error` and `band` in the same unit.
    """
    outside = np.flatnonzero(~(np.abs(error) <= band))
    settled = 0 if outside.size == 0 else outside[-1] + 1
    return float(time[settled]) if settled < len(time) else math.nan


# --- the script ---------------------------------------------------------------------------------


@contextmanager
def replacing(path: Path) -> Iterator[TextIO]:
    """Open a text file that takes the place of `path` once it is complete."""
    try:
        if path.exists() and not path.is_file():  # a device or a pipe cannot be replaced
            with path.open("w", encoding="utf-8") as file:
                yield file
            return
        target = path.resolve()  # what a link points to is replaced, not the link
        unfinished = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            with unfinished.open("w", encoding="utf-8", newline="\n") as file:
                yield file
            unfinished.replace(target)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise MasterError(f"{path} cannot be written: {error.strerror}") from error


def write_csv(file: TextIO, results: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """Write one column per variable: "plant.theta [rad]", and numbers that read back exactly."""
    print(",".join(f"{name} [{units[name]}]" for name in results), file=file)
    for row in zip(*[column.tolist() for column in results.values()], strict=True):
        print(",".join(map(repr, row)), file=file)


EXAMPLES = """\
examples:
  python tests/master.py
      the step response of the IPID-RBF controller that learns from itself
  python tests/master.py --controller Pid --signal square --disturbance 1 --csv pid.csv
      row 6 of the paper's Table 1, every sample of it
  python tests/master.py --controller IpidRbf --target supervisor --signal sine
      row 3: IPID-RBF beside the PID-RBF loop that it learns from
  python tests/master.py --order parallel --step 0.00025 --plant-model nonlinear
      as most tools step, four times per sample, with the nonlinear pendulum
  python tests/master.py --set controller.rbf.eta=0.5 --set plant.M=2
      other parameters; `cargo fmu info FILE` lists those of an FMU

A negative number in scientific notation needs an equals sign: --disturbance=-1e-3
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        description="Run one closed loop of the paper from its FMUs, coupled by FMPy.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "--controller",
        choices=list(PREVIOUS_SAMPLE_TERMS),
        default="IpidRbf",
        help="FMU that controls the pendulum (default: %(default)s)",
    )
    add(
        "--target",
        choices=["own", "supervisor"],
        default="own",
        help="what the network of IpidRbf learns: its own u, or the u of a PID-RBF loop that runs"
        " beside it, as in Table 1 (default: %(default)s)",
    )
    add(
        "--signal",
        choices=["step", "sine", "square"],
        default="step",
        help="reference, amplitude 1 rad; sine has 0.2 Hz, square 0.1 Hz (default: %(default)s)",
    )
    add(
        "--disturbance",
        type=float,
        default=0.0,
        metavar="AMPLITUDE",
        help="added to the measured angle from 5 s to 5.5 s [rad] (default: 0)",
    )
    add(
        "--plant-model",
        choices=["linear", "nonlinear", "transfer_function"],
        default="linear",
        help="model of the pendulum (default: %(default)s)",
    )
    add(
        "--order",
        choices=list(ORDERS),
        default="sequential",
        help="sequential: controller first, u acts at once; parallel: all step together, u acts"
        " one step later (default: %(default)s)",
    )
    add(
        "--step",
        type=float,
        default=TS,
        metavar="H",
        help="communication step [s] (default: %(default)s)",
    )
    add(
        "--start",
        type=float,
        default=TS,
        metavar="T",
        help="start time [s] (default: %(default)s, the paper's k = 1)",
    )
    add(
        "--stop",
        type=float,
        default=20.0,
        metavar="T",
        help="time of the last communication point [s] (default: %(default)s)",
    )
    add(
        "--previous-sample-terms",
        choices=["auto", "on", "off"],
        default="auto",
        help="whether u(k) uses the PID terms of sample k-1. auto: in sequential order as in the"
        " paper's Table 1 (on for Pid and PidRbf); in parallel order off, for the master delays"
        " by a sample already, and two are too many for the network",
    )
    add("-w0", type=float, nargs=4, metavar="W", help="initial weights of the network [N]")
    add(
        "--supervisor-w0",
        type=float,
        nargs=4,
        metavar="W",
        help="initial weights of the supervisor's network [N]",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="COMPONENT.VARIABLE=VALUE",
        type=_assignment,
        help="start value of any parameter; may be repeated. Components: controller, plant,"
        " source, and with --target supervisor also supervisor, supervisor_plant",
    )
    add(
        "--fmus",
        type=Path,
        default=FMUS,
        metavar="DIR",
        help="where the FMUs are (default: target/fmu of this project)",
    )
    add("--csv", type=Path, metavar="FILE", help="write time and all outputs to this file")
    return parser


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (equals and "." in name):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form component.variable=value")
    return name, value


def _previous_sample_terms(choice: str, order: str) -> bool | None:
    if choice == "auto":
        return None if order == "sequential" else False
    return choice == "on"


def run(options: argparse.Namespace) -> None:
    """Run the loop that the command line asks for, and say how it went."""
    steps = steps_until(options.stop, options.start, options.step)
    with ExitStack() as stack:
        file = stack.enter_context(replacing(options.csv)) if options.csv else None
        system = stack.enter_context(
            closed_loop(
                options.controller,
                options.signal,
                options.disturbance,
                target=options.target,
                plant_model=options.plant_model,
                w0=options.w0,
                supervisor_w0=options.supervisor_w0,
                previous_sample_terms=_previous_sample_terms(
                    options.previous_sample_terms, options.order
                ),
                overrides=dict(options.set),
                fmus=options.fmus,
            )
        )
        results = simulate(
            system, options.start, options.step, steps, order=options.order, progress=True
        )
        if file:
            units = {"time": "s", **{name: system.unit(name) for name in system.outputs()}}
            write_csv(file, results, units)
    print(summary(results, options.signal))
    if options.csv:
        print(f"wrote {options.csv}: {steps} rows")


def summary(results: Mapping[str, np.ndarray], signal: str) -> str:
    """Say in a few lines how well the controller did."""
    time, error = results["time"], results["controller.e"]
    lines = [
        f"final e         {error[-1]:.9e} rad at t = {time[-1]:.10g} s",
        f"largest |u|     {np.max(np.abs(results['controller.u'])):.9g} N",
    ]
    if signal == "step":
        # On a step, the band is relative to the reference
        band = SETTLING_BAND * abs(results["source.r"][-1])
        settled = settling_time(time, error, band)
        text = "never" if math.isnan(settled) else f"{settled:.10g} s"
        lines.insert(1, f"settling time   {text} (band of ±{SETTLING_BAND:.1%})")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the script; returns its exit status."""
    options = parser().parse_args(arguments)
    try:
        run(options)
    except MasterError as error:
        print(f"master.py: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("master.py: interrupted", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
