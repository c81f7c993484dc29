"""A delayed and noisy measurement of the angle, as a component in Python."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np


@dataclass(frozen=True)
class Variable:
    """The attributes of a variable that the master uses."""

    name: str
    causality: str
    valueReference: int  # noqa: N815 - FMI's name
    type: str = "Real"


class Measurement:
    """A component between plant and controller: `y` is `theta` with delay and noise.

    It implements the interface of a component that the master uses, including two FMI functions.

    Parameters
    ----------
    name
        Prefix of its variables.
    deviation
        Standard deviation of the noise [rad], white, one value per communication step.
    delay
        Delay in communication steps.
    seed
        Seed of the noise.
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
        """Return no outputs, so that none are recorded."""
        return []

    def initialize(self, time: float) -> None:
        """Start at `time` [s], with a delay line of zeros."""
        self.time = time

    def step(self, time: float, _step: float) -> None:
        """Store the newest angle, and output a delayed one with noise."""
        self.time = time
        self.line.append(self.values[0])
        self.values[1] = self.line[0] + self.deviation * self.noise.standard_normal()

    def close(self) -> None:
        """Do nothing, as there is no library to unload."""

    def _get(self, _component, references, count: int, values) -> None:
        for i in range(count):
            values[i] = self.values[references[i]]

    def _set(self, _component, references, count: int, values) -> None:
        for i in range(count):
            self.values[references[i]] = values[i]
