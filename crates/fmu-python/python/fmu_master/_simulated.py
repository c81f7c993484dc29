"""What environments simulate: instances of an FMU that are stepped together, or a system."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from . import _native
from ._command import COMMAND
from ._values import plain_starts
from .components import python_component
from .result import FmuError
from .system import System

Bounds = Mapping[str, tuple[float, float]]
"""The smallest and the largest value of each variable, by name, in its unit."""

NO_EPISODE = "the environment has no episode, expected a call of reset first"


class Fmus:
    """Instances of an FMU, one for each environment, which are stepped together."""

    def __init__(
        self,
        file: str | os.PathLike[str],
        count: int,
        actions: Bounds,
        observations: Bounds,
        step_size: float,
        steps: int,
        processes: int,
        in_process: bool,
    ):
        self._count, self._width = count, len(observations)
        command = [] if in_process else COMMAND
        observed = [(name, float(low), float(high)) for name, (low, high) in observations.items()]
        self._setup = {"file": Path(file).absolute()}
        self._arguments = (command, count, processes, list(actions), observed, step_size, steps)
        self._native: _native.Vector | None = None
        self._sizes: dict[str, Any] = {}
        self._structural: set[str] = set()

    def open(self, starts: Mapping[str, Any]) -> None:
        """Read the FMU, whose arrays get the sizes among the start values."""
        self.free()
        setup = {**self._setup, "sizes": plain_starts(starts)}
        self._native = _native.Vector(setup, *self._arguments)
        self._structural = set(self._native.structural())
        self._sizes = self._sizes_of(starts)

    def reset(self, starts: Mapping[int, Mapping[str, Any]], holds: bool = False) -> None:
        """Begin episodes, by the numbers of the environments; the next step may hold them."""
        first, *others = map(self._sizes_of, starts.values())
        if any(sizes != first for sizes in others) or (
            self._native is not None and first != self._sizes and len(starts) < self._count
        ):
            names = ", ".join(sorted(self._structural))
            raise FmuError(f"{names}: structural parameters, expected the same in all environments")
        if self._native is None or first != self._sizes:
            self.open(next(iter(starts.values())))
        episodes = [(number, plain_starts(values)) for number, values in starts.items()]
        self._opened().reset(episodes, holds)

    def observe(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the observations of all environments, and their times [s]."""
        observations, times = np.empty((self._count, self._width)), np.empty(self._count)
        self._opened().observe(observations, times)
        return observations, times

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Return observations, times [s], what is terminated and truncated, and whether any is."""
        observations, times = np.empty((self._count, self._width)), np.empty(self._count)
        ends = np.empty((2, self._count), np.uint8)
        is_over = self._opened().step(actions, observations, times, ends)
        return observations, times, ends.view(np.bool_), is_over

    def free(self) -> None:
        """Free the instances."""
        if self._native is not None:
            self._native.free()
            self._native = None

    def _opened(self) -> _native.Vector:
        if self._native is None:
            raise RuntimeError(NO_EPISODE)
        return self._native

    def _sizes_of(self, starts: Mapping[str, Any]) -> dict[str, Any]:
        return {name: starts[name] for name in self._structural & starts.keys()}


class _End(BaseException):
    """Ends the run of an episode that is not needed any longer."""


class _Episode:
    """The run of a system in a thread, which waits for actions."""

    def __init__(self, system: System, starts: Mapping[str, Any], options: dict[str, Any]) -> None:
        self.observed: SimpleQueue[tuple[float, tuple[float, ...]] | BaseException] = SimpleQueue()
        self.acting: SimpleQueue[list[float] | None] = SimpleQueue()
        run = (system, starts, options)
        self._thread = threading.Thread(target=self._run, args=run, daemon=True)

    def begin(self) -> None:
        """Start the run."""
        self._thread.start()

    def act(self, time: float, *values: float) -> list[float]:
        """Tell the observation at a time [s], and wait for the action."""
        self.observed.put((time, values))
        action = self.acting.get()
        if action is None:
            raise _End
        return action

    def end(self) -> None:
        """Wait until the run has ended."""
        self.acting.put(None)
        # The thread itself may collect the garbage.
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self, system: System, starts: Mapping[str, Any], options: dict[str, Any]) -> None:
        try:
            system.simulate(starts, output=["agent.a0"], **options)
        except BaseException as error:
            self.observed.put(error)
        else:
            self.observed.put(RuntimeError("the system has ended the run"))


class Loop:
    """A system, with a component in Python that applies the actions of one environment.

    The system stays loaded from one episode to the next. The thread of an episode does not hold the
    loop, so that it ends when an environment is dropped without `close`.
    """

    def __init__(
        self,
        system: System,
        actions: Bounds,
        observations: Bounds,
        step_size: float,
        steps: int,
        in_process: bool,
    ):
        self._system, self._actions, self._observations = system, actions, observations
        self._step_size, self._steps, self._in_process = step_size, steps, in_process
        self._low, self._high = np.array(list(observations.values()), np.float64).T
        self._loaded = contextlib.ExitStack()
        self._begin: Callable[[Mapping[str, Any]], _Episode] | None = None
        self._episode: _Episode | None = None
        self._end: Callable[[], object] = lambda: None
        self._count = 0

    def reset(self, starts: Mapping[int, Mapping[str, Any]]) -> None:
        """Begin an episode."""
        self._end_episode()
        if self._begin is None:
            self._begin = self._load()
        episode = self._begin(starts[0])
        # Also before Python ends: the thread could then no longer return from this module.
        self._end = weakref.finalize(self, episode.end)
        self._wait(episode)
        self._episode, self._count = episode, 0

    def observe(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the observation, and its time [s]."""
        return self._observation, self._time

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Act until the next sample."""
        if self._episode is None:
            raise RuntimeError(NO_EPISODE)
        for name, value in zip(self._actions, actions.tolist(), strict=True):
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value}, expected a finite number")
        self._episode.acting.put(actions.tolist())
        self._wait(self._episode)
        self._count += 1
        within = (self._low <= self._observation) & (self._observation <= self._high)
        ends = np.array([[not within.all()], [self._count >= self._steps]])
        return self._observation, self._time, ends, bool(ends.any())

    def free(self) -> None:
        """End the run, and free the system."""
        self._end_episode()
        self._loaded.close()
        self._begin = None

    def _end_episode(self) -> None:
        self._end()
        self._episode = None

    def _load(self) -> Callable[[Mapping[str, Any]], _Episode]:
        """Return what begins an episode of the loaded system, with start values."""
        acting: list[_Episode] = []

        def act(time: float, *values: float) -> list[float]:
            return acting[0].act(time, *values)

        seen = {f"o{number}": name for number, name in enumerate(self._observations)}
        acts = {f"a{number}": name for number, name in enumerate(self._actions)}
        links = [(name, f"agent.{own}") for own, name in seen.items()]
        links += [(f"agent.{own}", name) for own, name in acts.items()]
        agent = python_component(list(seen), list(acts), act, self._step_size)
        keys = self._system.keys()
        system = self._system.changed(
            component=[{"name": "agent", "fmu": agent}, *keys["component"]],
            connections=[*keys.get("connections", ()), *links],
        )
        start, _, step = system.times()
        if not np.isclose(self._step_size / step % 1, [0, 1], rtol=0, atol=1e-6).any():
            raise ValueError(f"step_size = {self._step_size}, expected a multiple of {step} s")
        stop = start + self._step_size * (self._steps + 1) + step
        options = {"stop_time": stop, "in_process": self._in_process}
        loaded = self._loaded.enter_context(system.loaded())

        def begin(starts: Mapping[str, Any]) -> _Episode:
            acting[:] = [_Episode(loaded, starts, options)]
            acting[0].begin()
            return acting[0]

        return begin

    def _wait(self, episode: _Episode) -> None:
        told = episode.observed.get()
        if isinstance(told, BaseException):
            episode.observed.put(told)  # for all later steps
            raise told
        self._time, self._observation = np.array([told[0]]), np.array([told[1]], np.float64)
