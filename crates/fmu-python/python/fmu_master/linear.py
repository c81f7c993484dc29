"""Linear models of FMUs and systems, at a point of a run."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ._names import suggests
from ._values import one_or_more
from .instance import Instance, Variable
from .responses import Signals, limits, realize, respond
from .result import FmuError
from .system import System, is_fmu

if TYPE_CHECKING:
    import control
    import scipy.signal
    from matplotlib.figure import Figure

_Names = Sequence[str]

_Pairs = Sequence[Sequence[str]]
"""The names of states and their derivatives."""

_DIFFERENCE = np.finfo(float).eps ** (1 / 3)
"""The step of differences, relative to the larger of 1 and the magnitude of a value."""


@dataclass(frozen=True)
class Linear:
    """The linear model x' = A x + B u, y = C x + D u of small deviations from a point of a run.

    With a `step`, x' is the state one step later.

    Attributes
    ----------
    A, B, C, D : numpy.ndarray
        The matrices, in the units of the variables and s.
    states, inputs, outputs : tuple of str
        The names of the variables.
    time : float
        The time of the point [s].
    step : float or None
        The step of a model of discrete time [s]; None for continuous time.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    time: float
    step: float | None = None

    @property
    def poles(self) -> np.ndarray:
        """The poles [1/s], the fastest growing one first; of discrete time, ln(z) / step."""
        poles = np.linalg.eigvals(self.A)
        if self.step is not None:
            with np.errstate(divide="ignore"):
                poles = np.log(poles.astype(complex)) / self.step
        return poles[np.argsort(-poles.real, kind="stable")]

    def to_scipy(self) -> scipy.signal.StateSpace:
        """Return the model for `scipy.signal`."""
        from scipy.signal import StateSpace

        dt = {} if self.step is None else {"dt": self.step}
        return StateSpace(self.A, self.B, self.C, self.D, **dt)

    def to_control(self) -> control.StateSpace:
        """Return the model for python-control, with the names of the variables."""
        import control

        # python-control uses dots for the names of subsystems.
        groups = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        names = {key: [n.replace(".", "_") for n in group] for key, group in groups.items()}
        return control.ss(self.A, self.B, self.C, self.D, dt=self.step or 0, **names)

    def bode(self, frequencies: Sequence[float] | None = None) -> Figure:
        """Draw magnitude and phase over the frequency [rad/s]; returns the figure of Matplotlib."""
        import control

        response = control.frequency_response(self.to_control(), frequencies)
        is_single = len(self.inputs) == len(self.outputs) == 1
        figure: Figure = response.plot(display_margins=is_single).figure
        return figure

    def margins(self) -> tuple[float, float, float, float]:
        """Return the margins of the open loop from the only input to the only output.

        They are those under negative feedback: the gain margin (a factor), the phase margin
        [deg], and the frequencies [rad/s] of both, as `control.margin` returns them.
        """
        import control

        if (len(self.inputs), len(self.outputs)) != (1, 1):
            raise ValueError(
                f"inputs: {len(self.inputs)}, outputs: {len(self.outputs)}, expected one of each"
            )
        gain, phase, at_180, at_1 = map(float, control.margin(self.to_control()))
        return gain, phase, at_180, at_1


@suggests
def linearize(
    system: System | str | os.PathLike[str],
    time: float | None = None,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    start_values: Mapping[str, Any] | None = None,
    input: Signals | None = None,
    step_size: float = 0.001,
    deviation: float = 1e-4,
    tolerance: float = 1e-9,
) -> Linear:
    """Return the linear model of an FMU for model exchange, or of a system, at a point of a run.

    The model of an FMU has continuous time and the states of the FMU. It is computed from the
    directional derivatives, or from differences of second order if the FMU does not provide them.

    The model of a system, with all its controllers, has discrete time, with the communication step.
    It responds like the system to a pulse that is added to each input for one step, from the point
    to the stop time, and has the smallest number of states for this, named x1, x2, ...

    Deviations keep to the `min` and `max` of states and inputs: where a bound is near, they are on
    the other side of the point.

    Parameters
    ----------
    system
        An FMU, or a system or its file.
    time
        The time of the point [s], by default the start time. Choose one at which a system is at
        rest: its model is the same at all later times.
    inputs, outputs
        The inputs and outputs of the model: of an FMU, by default all continuous real numbers,
        including elements of arrays; of a system, `component.variable`, which may be connected.
    start_values
        Start values by name, also of inputs.
    input
        Functions of the time [s] for inputs.
    step_size
        The longest step of the run of an FMU to the point [s].
    deviation
        The height of the pulses of a system, relative to the larger of 1 and the value, so small
        that no limit acts.
    tolerance
        The largest deviation of the model from the responses of a system, relative to the largest
        response of each output. Increase it for FMUs that compute less accurately.

    Raises
    ------
    FmuError
        The FMU does not support model exchange, or fails; or no linear model responds in the same
        way as the system.
    """
    positive = {"step_size": step_size, "deviation": deviation, "tolerance": tolerance}
    for name, value in positive.items():
        if not 0 < value < np.inf:
            raise ValueError(f"{name} = {value}, expected a positive number")
    inputs, outputs = (n if n is None else one_or_more(n) for n in (inputs, outputs))
    if not isinstance(system, System) and is_fmu(system):
        return _of_fmu(system, time, inputs, outputs, start_values, input or {}, step_size)
    if not inputs or not outputs:
        raise ValueError("expected the names of inputs and outputs of the system")
    system = system if isinstance(system, System) else System(system)
    about = (inputs, outputs, start_values, input or {}, deviation, tolerance)
    responses, at, step = respond(system, time, *about)
    matrices = realize(responses, tolerance)
    states = tuple(f"x{number + 1}" for number in range(len(matrices[0])))
    return Linear(*matrices, states, tuple(inputs), tuple(outputs), at, step)


def _of_fmu(
    filename: str | os.PathLike[str],
    time: float | None,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    start_values: Mapping[str, Any] | None,
    signals: Signals,
    step_size: float,
) -> Linear:
    """Return the linear model of an FMU for model exchange."""
    if time is not None and not 0 <= time < np.inf:
        raise ValueError(f"time = {time}, expected at least 0 s")
    with Instance(filename, "model-exchange", start_values) as fmu:
        until = time or 0.0
        steps = math.ceil(until / step_size - 1e-6)
        step = until / max(steps, 1)
        for _ in range(steps):
            # What is held during a step is that of its middle.
            fmu.set({name: function(fmu.time + step / 2) for name, function in signals.items()})
            fmu.step(step)
        fmu.set({name: function(fmu.time) for name, function in signals.items()})
        names = [_continuous(fmu, "input") if inputs is None else inputs]
        names.append(_continuous(fmu, "output") if outputs is None else outputs)
        for name in names[0]:
            found = _variable(fmu, name)
            if found is not None and found.causality != "input":
                raise FmuError(f"{name} has the causality {found.causality}, expected an input")
        pairs, are_directional = fmu._equations()
        states = [state for state, _ in pairs]
        if any(fmu.variables[name].dimensions for name in states):
            raise FmuError(f"{filename}: a state is an array, which linearize does not support")
        model = _directional if are_directional else _differences
        matrix = model(fmu, pairs, *names)
        n = len(states)
        parts = (matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:])
        return Linear(*parts, tuple(states), tuple(names[0]), tuple(names[1]), fmu.time)


def _continuous(fmu: Instance, causality: str) -> list[str]:
    """Return the names of the continuous real scalars with a causality."""
    return [
        name
        for name, v in fmu.variables.items()
        if v.causality == causality
        and v.variability == "continuous"
        and v.type.startswith("Float")
        and not v.dimensions
    ]


def _directional(fmu: Instance, pairs: _Pairs, inputs: _Names, outputs: _Names) -> np.ndarray:
    """Return [[A, B], [C, D]] from directional derivatives."""
    unknowns = [*(derivative for _, derivative in pairs), *outputs]
    knowns = [*(state for state, _ in pairs), *inputs]
    columns = [fmu.directional_derivative(unknowns, [known], [1.0]) for known in knowns]
    return np.reshape(np.array(columns), (len(knowns), len(unknowns))).T


def _differences(fmu: Instance, pairs: _Pairs, inputs: _Names, outputs: _Names) -> np.ndarray:
    """Return [[A, B], [C, D]] from differences of second order within the bounds of variables."""
    at, given = fmu.continuous_states, np.array([float(fmu.get(name)) for name in inputs])
    point = np.concatenate([at, given])

    def evaluate(values: np.ndarray) -> np.ndarray:
        fmu.set(dict(zip(inputs, values[len(at) :].tolist(), strict=True)))
        fmu.continuous_states = values[: len(at)].tolist()
        got = [float(fmu.get(name)) for name in outputs]
        return np.concatenate([fmu.derivatives(), got])

    middle = evaluate(point)
    columns = []
    for index, name in enumerate([*(state for state, _ in pairs), *inputs]):
        changes = []
        for neighbour in _neighbours(fmu, name, float(point[index])):
            values = point.copy()
            values[index] = neighbour
            changes.append((neighbour - point[index], evaluate(values) - middle))
        (a, of_a), (b, of_b) = changes
        # The slope of the parabola through the three points.
        columns.append((of_a * (b / a) - of_b * (a / b)) / (b - a))
    evaluate(point)
    return np.reshape(columns, (len(point), len(pairs) + len(outputs))).T


def _neighbours(fmu: Instance, name: str, value: float) -> tuple[float, float]:
    """Return the values of a difference: on both sides, or on one if a bound is near."""
    variable = _variable(fmu, name)
    low, high = limits(name, value, *((variable.min, variable.max) if variable else (None, None)))
    step = _DIFFERENCE * max(1.0, abs(value))
    below, above = value - low, high - value
    # Near a bound, a derivative may change quickly, as that of a square root at 0.
    margin = min(below, above) / 64
    is_inside = margin > 1e-4 * step
    on_both = min(step, margin if is_inside else 64 * margin)
    on_one = min(step, max(below, above) / 2)
    if is_inside or on_both > on_one:
        others = (value - on_both, value + on_both)
    else:
        on_one = on_one if above > below else -on_one
        others = (value + on_one, value + 2 * on_one)
    first, second = (min(max(other, low), high) for other in others)
    return first, second


def _variable(fmu: Instance, name: str) -> Variable | None:
    """Return a variable by its name or by that of an element."""
    return fmu.variables.get(name) or fmu.variables.get(name.rpartition("[")[0])
