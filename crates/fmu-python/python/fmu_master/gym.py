"""An environment of Gymnasium whose dynamics is an FMU or a system, for reinforcement learning."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Mapping
from queue import SimpleQueue
from typing import Any

import gymnasium
import numpy as np

from .components import python_component
from .instance import Instance
from .system import System, is_fmu

Bounds = Mapping[str, tuple[float, float]]
"""The smallest and the largest value of each variable, by name, in its unit."""


class FmuEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """An FMU or a system as an environment: actions are inputs, observations variables.

    Parameters
    ----------
    system
        An FMU, or a system or its file.
    actions
        The inputs that an action sets, and their bounds. In a system, they must not be connected.
    observations
        The observed variables, and their bounds; in a system, real outputs. An episode terminates
        when one leaves its bounds.
    reward
        Receives the observation after a step and the action.
    step_size
        The time from one action to the next [s]; in a system, a multiple of its step.
    stop_time
        The length of an episode [s], after which it is truncated.
    start
        Returns start values for an episode; it receives the random generator of the environment.
    in_process
        Run the FMU in this process, which is faster; an FMU that crashes ends Python.
    """

    def __init__(
        self,
        system: System | str | os.PathLike[str],
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
        if not isinstance(system, System) and not is_fmu(system):
            system = System(system)
        self._system = system
        self._start, self._reward = start, reward
        self._actions, self._observations = list(actions), list(observations)
        self._step_size, self._steps = step_size, round(stop_time / step_size)
        self._in_process = in_process
        self._fmu: Instance | _Loop | None = None
        self._count = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options` are start values that replace values of `start`."""
        super().reset(seed=seed)
        self.close()
        starts = {**self._start(self.np_random), **(options or {})}
        if isinstance(self._system, System):
            self._fmu = _Loop(self, self._system, starts)
        else:
            self._fmu = Instance(self._system, start_values=starts, in_process=self._in_process)
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
        """End the episode, and free its FMUs."""
        if self._fmu is not None:
            self._fmu.free()
            self._fmu = None

    def _observe(self, fmu: Instance | _Loop) -> np.ndarray:
        return np.asarray(fmu.get(self._observations), np.float64)


class _End(BaseException):
    """Ends the run of an episode that is not needed any longer."""


def _run(
    observed: SimpleQueue[Any], system: System, starts: Mapping[str, Any], options: dict[str, Any]
) -> None:
    try:
        system.simulate(starts, output=["agent.a0"], **options)
    except BaseException as error:
        observed.put(error)
    else:
        observed.put(RuntimeError("the system has ended the run"))


def _end(acting: SimpleQueue[list[float] | None], thread: threading.Thread) -> None:
    acting.put(None)
    # The thread itself may collect the garbage.
    if thread is not threading.current_thread():
        thread.join()


class _Loop:
    """A run of a system in a thread, with a component in Python that applies the actions.

    It has the methods of an instance that is stepped by hand. The thread does not hold it, so that
    it ends when an environment is dropped without `close`.
    """

    def __init__(self, env: FmuEnv, system: System, starts: Mapping[str, Any]):
        self._observed: SimpleQueue[tuple[float, tuple[float, ...]] | BaseException] = SimpleQueue()
        self._acting: SimpleQueue[list[float] | None] = SimpleQueue()
        observed, acting = self._observed, self._acting
        self._action = [0.0] * len(env._actions)
        seen = {f"o{number}": name for number, name in enumerate(env._observations)}
        acts = {f"a{number}": name for number, name in enumerate(env._actions)}
        links = [(name, f"agent.{own}") for own, name in seen.items()]
        links += [(f"agent.{own}", name) for own, name in acts.items()]

        def act(time: float, *values: float) -> list[float]:
            observed.put((time, values))
            action = acting.get()
            if action is None:
                raise _End
            return action

        agent = python_component(list(seen), list(acts), act, env._step_size)
        keys = system.keys()
        system = system.changed(
            component=[{"name": "agent", "fmu": agent}, *keys["component"]],
            connections=[*keys.get("connections", ()), *links],
        )
        start, _, step = system.times()
        if not np.isclose(env._step_size / step % 1, [0, 1], rtol=0, atol=1e-6).any():
            raise ValueError(f"step_size = {env._step_size}, expected a multiple of {step} s")
        stop = start + env._step_size * (env._steps + 1) + step
        options = {"stop_time": stop, "in_process": env._in_process}
        arguments = (observed, system, starts, options)
        thread = threading.Thread(target=_run, args=arguments, daemon=True)
        thread.start()
        # Also before Python ends: the thread could then no longer return from this module.
        self._end = weakref.finalize(self, _end, acting, thread)
        self._wait()

    def _wait(self) -> None:
        told = self._observed.get()
        if isinstance(told, BaseException):
            self._observed.put(told)  # for all later steps
            raise told
        self.time, self._values = told

    def get(self, names: list[str]) -> tuple[float, ...]:
        """Return what is observed."""
        return self._values

    def set(self, values: Mapping[str, float]) -> None:
        """Set the next action."""
        self._action = list(values.values())

    def step(self, step_size: float) -> None:
        """Act until the next sample."""
        self._acting.put(self._action)
        self._wait()

    def free(self) -> None:
        """End the run."""
        self._end()


def _box(bounds: Bounds) -> gymnasium.spaces.Box:
    low, high = (np.array(column, np.float64) for column in zip(*bounds.values(), strict=True))
    return gymnasium.spaces.Box(low, high, dtype=np.float64)
