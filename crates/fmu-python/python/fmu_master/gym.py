"""Environments of Gymnasium whose dynamics is an FMU or a system, for reinforcement learning."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ._simulated import Bounds, Fmus, Loop
from .system import System, is_fmu


class FmuEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """An FMU or a system as an environment: actions are inputs, observations variables.

    The FMU stays loaded from one episode to the next.

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
        self.action_space = _box("actions", actions)
        self.observation_space = _box("observations", observations)
        if not isinstance(system, System) and not is_fmu(system):
            system = System(system)
        self._start, self._reward = start, reward
        episode = (actions, observations, step_size, _steps(step_size, stop_time))
        self._simulated: Fmus | Loop
        if isinstance(system, System):
            self._simulated = Loop(system, *episode, in_process)
        else:
            self._simulated = Fmus(system, 1, *episode, 1, in_process)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options` are start values that replace values of `start`."""
        super().reset(seed=seed)
        starts = {**self._start(self.np_random), **(options or {})}
        self._simulated.reset({0: starts})
        observations, times = self._simulated.observe()
        return observations[0], {"time": times.item()}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Set the inputs and step; returns observation, reward, terminated, truncated, info."""
        given = np.array(action, np.float64)
        if given.shape != self.action_space.shape:
            (expected,) = self.action_space.shape or ()
            if given.ndim == 1:
                raise ValueError(f"{given.size} actions, expected {expected}")
            raise ValueError(f"action = {action!r}, expected an array of {expected}")
        observations, times, ends, _ = self._simulated.step(given)
        terminated, truncated = ends.ravel().tolist()
        observation = observations[0]
        reward = float(self._reward(observation, given))
        return observation, reward, terminated, truncated, {"time": times.item()}

    def close(self) -> None:
        """End the episode, and free its FMUs."""
        self._simulated.free()


class FmuVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Instances of an FMU as environments that are stepped in one call, on all cores.

    Environment k behaves as an `FmuEnv` with the same arguments and the seed of the vector plus k,
    bit for bit. It is much faster: arrays go to the FMU and back as a whole. For a system, use
    `gymnasium.vector.SyncVectorEnv` of `FmuEnv`.

    If an instance fails, the error names it, and all environments need a `reset`, which starts what
    has failed again.

    Parameters
    ----------
    fmu
        The FMU.
    num_envs
        The number of instances.
    actions
        The inputs that an action sets, and their bounds.
    observations
        The observed variables, and their bounds. An episode terminates when one leaves its bounds.
    reward
        Receives the observations after a step and the actions, as arrays with a row for each
        environment; returns an array of the rewards.
    step_size
        The time from one action to the next [s].
    stop_time
        The length of an episode [s], after which it is truncated.
    start
        Returns start values for an episode; it receives the random generator of the environment.
    processes
        The number of child processes that share the instances, by default one for each core; with
        `in_process`, of threads.
    in_process
        Run the instances in this process; an FMU that crashes ends Python. Each is always called
        by the same thread, the first ones by the thread that steps.
    autoreset_mode
        When the next episode of an environment begins, as for Gymnasium's `SyncVectorEnv`: with the
        next step, which ignores the action; in the same step, with the last observation in
        `infos["final_obs"]`; or only by `reset`.

    Raises
    ------
    FmuError
        The FMU cannot be used, or fails, or there is no such variable.
    TypeError, ValueError
        An argument is of a wrong type, or invalid.
    """

    def __init__(
        self,
        fmu: str | os.PathLike[str],
        num_envs: int,
        *,
        actions: Bounds,
        observations: Bounds,
        reward: Callable[[np.ndarray, np.ndarray], np.ndarray],
        step_size: float,
        stop_time: float,
        start: Callable[[np.random.Generator], Mapping[str, Any]] = lambda random: {},
        processes: int = 0,
        in_process: bool = False,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        if isinstance(fmu, System) or not is_fmu(fmu):
            expected = "an FMU; use gymnasium.vector.SyncVectorEnv of FmuEnv for a system"
            raise TypeError(f"fmu = {fmu!r}, expected {expected}")
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}, expected at least 1")
        if processes < 0:
            raise ValueError(f"processes = {processes}, expected at least 1, or 0 for all cores")
        self.num_envs = num_envs
        self.single_action_space = _box("actions", actions)
        self.single_observation_space = _box("observations", observations)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self._mode}
        self._start, self._reward = start, reward
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        self._over: np.ndarray | None = None
        steps = _steps(step_size, stop_time)
        self._fmus = Fmus(
            fmu, num_envs, actions, observations, step_size, steps, processes, in_process
        )
        self._fmus.open({})

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The random generator of each environment."""
        return tuple(map(self._random, range(self.num_envs)))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each environment."""
        for number in range(self.num_envs):
            self._random(number)
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes.

        Environment k gets `seed` + k, or its seed of a sequence. `options` are start values that
        replace values of `start`. With a Boolean array `options["reset_mask"]`, only these
        environments begin a new episode.
        """
        self._check_open()
        options = dict(options or {})
        mask = self._mask(options.pop("reset_mask", None))
        seeds = self._seeds_of(seed)
        numbers = np.flatnonzero(mask).tolist()
        for number in numbers:
            if seeds[number] is not None:
                self._seed(number, seeds[number])
        self._begin(numbers, options)
        if self._over is not None:
            self._over &= ~mask
        observations, times = self._fmus.observe()
        return observations, {"time": np.where(mask, times, 0.0), "_time": mask}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all; returns observations, rewards, terminations, truncations, infos."""
        self._check_open()
        given = np.array(actions, np.float64, order="C")
        if given.shape != self.action_space.shape:
            expected = f"expected {self.action_space.shape}"
            raise ValueError(f"actions of the shape {given.shape}, {expected}")
        held = None
        if self._over is not None and self._over.any():
            if self._mode == AutoresetMode.DISABLED:
                ended = ", ".join(map(str, np.flatnonzero(self._over)))
                expected = 'expected a reset with them in options={"reset_mask": ...}'
                raise RuntimeError(f"the episodes of environments {ended} are over, {expected}")
            held = self._over
            self._begin(np.flatnonzero(held).tolist(), holds=True)
        observations, times, ends, is_over = self._fmus.step(given)
        rewards = np.array(self._reward(observations, given), np.float64)
        if rewards.shape != (self.num_envs,):
            expected = f"expected ({self.num_envs},), a reward for each environment"
            raise ValueError(f"reward returns the shape {rewards.shape}, {expected}")
        if held is not None:
            rewards[held] = 0.0
        everywhere = np.ones(self.num_envs, np.bool_)
        infos: dict[str, Any] = {"time": times, "_time": everywhere}
        terminations, truncations = ends
        over = terminations | truncations if is_over else None
        if over is not None and self._mode == AutoresetMode.SAME_STEP:
            observations, infos = self._reset_in_step(over, observations, times)
            over = None
        self._over = over
        return observations, rewards, terminations, truncations, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Free the instances."""
        self._fmus.free()

    def _reset_in_step(
        self, over: np.ndarray, observations: np.ndarray, times: np.ndarray
    ) -> tuple[np.ndarray, dict[str, Any]]:
        numbers = np.flatnonzero(over).tolist()
        final = np.full(self.num_envs, None, object)
        for number in numbers:
            final[number] = observations[number]
        ended = {"time": np.where(over, times, 0.0), "_time": over}
        self._begin(numbers)
        observations, times = self._fmus.observe()
        infos = {"final_obs": final, "final_info": ended, "time": times}
        masks = {"_final_obs": over, "_final_info": over, "_time": np.ones_like(over)}
        return observations, {**infos, **masks}

    def _begin(
        self, numbers: Iterable[int], options: Mapping[str, Any] = {}, holds: bool = False
    ) -> None:
        starts = {k: {**self._start(self._random(k)), **options} for k in numbers}
        self._fmus.reset(starts, holds)

    def _random(self, number: int) -> np.random.Generator:
        random = self._randoms[number]
        return random if random is not None else self._seed(number, None)

    def _seed(self, number: int, seed: int | None) -> np.random.Generator:
        random, self._seeds[number] = seeding.np_random(seed)
        self._randoms[number] = random
        return random

    def _seeds_of(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + number for number in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds, expected {self.num_envs}")
        return list(seed)

    def _mask(self, mask: Any) -> np.ndarray:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"reset_mask = {mask!r}, expected an array of Booleans")
        if mask.shape != (self.num_envs,) or not mask.any():
            expected = f"expected ({self.num_envs},), with at least one True"
            raise ValueError(f"reset_mask = {mask} of the shape {mask.shape}, {expected}")
        return mask.copy()

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError("the environment is closed, expected a new one")


def _steps(step_size: float, stop_time: float) -> int:
    if not (0 < step_size < np.inf and step_size <= stop_time < np.inf):
        expected = "expected a positive step_size, and a stop_time that is not smaller"
        raise ValueError(f"step_size = {step_size}, stop_time = {stop_time}, {expected}")
    return round(stop_time / step_size)


def _box(argument: str, bounds: Bounds) -> gymnasium.spaces.Box:
    if not bounds:
        raise ValueError(f"{argument} has no variable, expected at least one and its bounds")
    low, high = np.array(list(bounds.values()), np.float64).T
    return gymnasium.spaces.Box(low, high, dtype=np.float64)
