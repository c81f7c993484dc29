"""An environment of Gymnasium whose dynamics is an FMU, for reinforcement learning."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np

from .instance import Instance

Bounds = Mapping[str, tuple[float, float]]
"""The smallest and the largest value of each variable, by name, in its unit."""


class FmuEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """An FMU as an environment: actions are its inputs, observations its outputs.

    Parameters
    ----------
    filename
        The FMU.
    actions
        The inputs that an action sets, and their bounds.
    observations
        The variables that are observed, and their bounds. An episode terminates when one is beyond.
    reward
        Receives the observation after a step and the action.
    step_size
        The time from one action to the next [s].
    stop_time
        The length of an episode [s], after which it is truncated.
    start
        Returns start values for an episode; it receives the random generator of the environment.
    in_process
        Run the FMU in this process, which is faster; an FMU that crashes ends Python.
    """

    def __init__(
        self,
        filename: str | os.PathLike[str],
        *,
        actions: Bounds,
        observations: Bounds,
        reward: Callable[[np.ndarray, np.ndarray], float],
        step_size: float,
        stop_time: float,
        start: Callable[[np.random.Generator], Mapping[str, Any]] = lambda random: {},
        in_process: bool = False,
    ):
        self.action_space = _box(actions)
        self.observation_space = _box(observations)
        self._filename, self._start, self._reward = filename, start, reward
        self._actions, self._observations = list(actions), list(observations)
        self._step_size, self._steps = step_size, round(stop_time / step_size)
        self._in_process = in_process
        self._fmu: Instance | None = None
        self._count = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options` are start values that replace those of `start`."""
        super().reset(seed=seed)
        self.close()
        starts = {**self._start(self.np_random), **(options or {})}
        self._fmu = Instance(self._filename, start_values=starts, in_process=self._in_process)
        self._count = 0
        return self._observe(self._fmu), {"time": self._fmu.time}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Set the inputs and step; returns observation, reward, terminated, truncated, info."""
        if self._fmu is None:
            raise RuntimeError("the environment has no episode, expected a call of reset first")
        self._fmu.set(dict(zip(self._actions, np.asarray(action, float).tolist(), strict=True)))
        self._fmu.step(self._step_size)
        self._count += 1
        observation = self._observe(self._fmu)
        terminated = not self.observation_space.contains(observation)
        truncated = self._count >= self._steps
        reward = float(self._reward(observation, action))
        return observation, reward, terminated, truncated, {"time": self._fmu.time}

    def close(self) -> None:
        """Free the FMU."""
        if self._fmu is not None:
            self._fmu.free()
            self._fmu = None

    def _observe(self, fmu: Instance) -> np.ndarray:
        return np.asarray(fmu.get(self._observations), np.float64)


def _box(bounds: Bounds) -> gymnasium.spaces.Box:
    low, high = (np.array(column, np.float64) for column in zip(*bounds.values(), strict=True))
    return gymnasium.spaces.Box(low, high, dtype=np.float64)
