"""Linear models of FMUs, at a point of a run."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .instance import Instance
from .result import FmuError

if TYPE_CHECKING:
    import control
    import scipy.signal
    from matplotlib.figure import Figure

_DIFFERENCE = np.finfo(float).eps ** (1 / 3)
"""The step of central differences, relative to the larger of 1 and the magnitude of a value."""


@dataclass(frozen=True)
class Linear:
    """The linear model x' = A x + B u, y = C x + D u of small deviations from a point of a run.

    Attributes
    ----------
    A, B, C, D : numpy.ndarray
        The matrices, in the units of the variables and s.
    states, inputs, outputs : tuple of str
        The names of the variables.
    time : float
        The time of the point [s].
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    time: float

    @property
    def poles(self) -> np.ndarray:
        """The poles [1/s], the fastest growing one first."""
        poles = np.linalg.eigvals(self.A)
        return poles[np.argsort(-poles.real, kind="stable")]

    def to_scipy(self) -> scipy.signal.StateSpace:
        """Return the model for `scipy.signal`."""
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> control.StateSpace:
        """Return the model for python-control, with the names of the variables."""
        import control

        # python-control uses dots for the names of subsystems.
        names = {
            "states": [name.replace(".", "_") for name in self.states],
            "inputs": [name.replace(".", "_") for name in self.inputs],
            "outputs": [name.replace(".", "_") for name in self.outputs],
        }
        return control.ss(self.A, self.B, self.C, self.D, **names)

    def bode(self, frequencies: Sequence[float] | None = None) -> Figure:
        """Draw magnitude and phase over the frequency [rad/s]; returns the figure of Matplotlib."""
        import control

        response = control.frequency_response(self.to_control(), frequencies)
        return response.plot(display_margins=len(self.inputs) == len(self.outputs) == 1).figure

    def margins(self) -> tuple[float, float, float, float]:
        """Return the margins of the open loop from the only input to the only output.

        They are those under negative feedback: the gain margin (a factor), the phase margin
        [deg], and the frequencies [rad/s] of both, as `control.margin` returns them.
        """
        import control

        if (len(self.inputs), len(self.outputs)) != (1, 1):
            raise ValueError(
                f"the model has {len(self.inputs)} inputs and {len(self.outputs)} outputs, "
                "expected one of each"
            )
        return tuple(float(value) for value in control.margin(self.to_control()))


def linearize(
    filename: str | os.PathLike[str],
    time: float | None = None,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    start_values: Mapping[str, Any] | None = None,
    input: Mapping[str, Callable[[float], float]] | None = None,
    step_size: float = 0.001,
) -> Linear:
    """Return the linear model of an FMU for model exchange at a point of a run.

    It comes from directional derivatives if the FMU has them, else from central differences.

    Parameters
    ----------
    filename
        The FMU.
    time
        The time of the point [s], by default the start time 0.
    inputs, outputs
        The inputs and outputs of the model, by default all that are continuous real numbers. They
        may be elements of arrays.
    start_values
        Start values by name, also of inputs.
    input
        Functions of the time [s] that inputs follow until the point.
    step_size
        The step of the run until the point [s].

    Raises
    ------
    FmuError
        The FMU does not support model exchange, or fails.
    """
    with Instance(filename, "model-exchange", start_values) as fmu:
        steps = 0 if time is None else round(time / step_size)
        for _ in range(steps):
            fmu.set({name: function(fmu.time) for name, function in (input or {}).items()})
            fmu.step(step_size)
        fmu.set({name: function(fmu.time) for name, function in (input or {}).items()})
        names = [_continuous(fmu, "input") if inputs is None else list(inputs)]
        names.append(_continuous(fmu, "output") if outputs is None else list(outputs))
        pairs, are_directional = fmu._native.equations()
        states, derivatives = ([pair[k] for pair in pairs] for k in (0, 1))
        if any(fmu.variables[name].dimensions for name in states):
            raise FmuError(f"{filename}: a state is an array, which linearize does not support")
        model = _directional if are_directional else _differences
        matrix = model(fmu, states, derivatives, *names)
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


def _directional(
    fmu: Instance,
    states: list[str],
    derivatives: list[str],
    inputs: list[str],
    outputs: list[str],
) -> np.ndarray:
    """Return [[A, B], [C, D]] from directional derivatives."""
    unknowns, knowns = [*derivatives, *outputs], [*states, *inputs]
    columns = [fmu.directional_derivative(unknowns, [known], [1.0]) for known in knowns]
    return np.reshape(np.array(columns), (len(knowns), len(unknowns))).T


def _differences(
    fmu: Instance,
    states: list[str],
    derivatives: list[str],
    inputs: list[str],
    outputs: list[str],
) -> np.ndarray:
    """Return [[A, B], [C, D]] from central differences."""
    at, given = fmu.continuous_states, np.array([float(fmu.get(name)) for name in inputs])
    point = np.concatenate([at, given])

    def evaluate(values: np.ndarray) -> np.ndarray:
        fmu.set(dict(zip(inputs, values[len(at) :].tolist(), strict=True)))
        fmu.continuous_states = values[: len(at)]
        got = [float(fmu.get(name)) for name in outputs]
        return np.concatenate([fmu.derivatives(), got])

    columns = []
    for index, value in enumerate(point):
        high, low = point.copy(), point.copy()
        high[index] += _DIFFERENCE * max(1.0, abs(value))
        low[index] -= _DIFFERENCE * max(1.0, abs(value))
        columns.append((evaluate(high) - evaluate(low)) / (high[index] - low[index]))
    evaluate(point)
    return np.reshape(columns, (len(point), len(derivatives) + len(outputs))).T
