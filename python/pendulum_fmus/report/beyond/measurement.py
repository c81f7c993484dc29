"""A measurement of the angle that comes late and is noisy, as a component in Python."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np


@dataclass(frozen=True)
class Variable:
    """What the master wants to know of a variable."""

    name: str
    causality: str
    valueReference: int  # noqa: N815 - FMI's name
    type: str = "Real"


class Measurement:
    """Stands between plant and controller like an FMU: `y` is `theta`, late and with noise.

    It has what the master uses of a component, its two FMI functions among it.

    Parameters
    ----------
    name
        Prefix of its variables.
    deviation
        Standard deviation of the noise [rad], white, one value per communication step.
    delay
        In communication steps.
    seed
        Of the noise.
    """

    sampled = True
    VARIABLES = (Variable("theta", "input", 0), Variable("y", "output", 1))

    def __init__(self, name: str, deviation: float = 0.0, delay: int = 0, seed: int = 1):
        self.name = name
        self.noise = np.random.default_rng(seed)
        self.deviation = deviation
        self.line = deque([0.0] * (delay + 1), maxlen=delay + 1)
        self.values = [0.0, 0.0]
        self.time = math.nan
        self.slave = SimpleNamespace(component=None, fmi2GetReal=self._get, fmi2SetReal=self._set)

    def variable(self, name: str) -> Variable:
        """Look up a variable."""
        return next(v for v in self.VARIABLES if v.name == name)

    def unit(self, _name: str) -> str:
        """Return the unit of both variables."""
        return "rad"

    def outputs(self) -> Sequence[str]:
        """Return no outputs: nobody records it."""
        return []

    def initialize(self, time: float) -> None:
        """Start at `time` [s], with zeros in the line."""
        self.time = time

    def step(self, time: float, _step: float) -> None:
        """Take the newest angle in, and give out an old one with noise."""
        self.time = time
        self.line.append(self.values[0])
        self.values[1] = self.line[0] + self.deviation * self.noise.standard_normal()

    def close(self) -> None:
        """Do nothing: there is no library to unload."""

    def _get(self, _component, references, count: int, values) -> None:
        for i in range(count):
            values[i] = self.values[references[i]]

    def _set(self, _component, references, count: int, values) -> None:
        for i in range(count):
            self.values[references[i]] = values[i]
