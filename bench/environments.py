"""Measures environments for reinforcement learning, and prints the times [ns] by name as JSON.

Arguments: the folder of the FMUs, the number of rounds, the seconds for each subject in a round,
and the sizes of vectors. The environment is the plant, which is pushed at random every
millisecond, in episodes from a random angle until it falls. Subjects that are not installed are
left out.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv

from fmu_master.gym import FmuEnv, FmuVectorEnv

PLANT = Path(sys.argv[1]) / "Pendulum.fmu"

SETTINGS: dict[str, Any] = {
    "actions": {"u": (-1.0, 1.0)},
    "observations": {"theta": (-0.2, 0.2)},
    "step_size": 0.001,
    "stop_time": 1.0,
    "start": lambda random: {"theta0": random.uniform(-0.05, 0.05)},
}


def one(in_process: bool = True) -> FmuEnv:
    """Return an environment."""
    return FmuEnv(
        PLANT, reward=lambda seen, action: -abs(seen[0]), in_process=in_process, **SETTINGS
    )


def by_us(size: int, **options: Any) -> VectorEnv:
    """Return a vector of our own."""

    def reward(seen: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return -np.abs(seen[:, 0])

    return FmuVectorEnv(PLANT, size, reward=reward, **options, **SETTINGS)


def by_gymnasium(kind: type[VectorEnv], size: int) -> VectorEnv:
    """Return a vector of a class of Gymnasium."""
    return kind([one] * size)


def by_envpool(task: str, threads: int, size: int) -> VectorEnv:
    """Return a vector of EnvPool."""
    import envpool

    return envpool.make_gymnasium(task, num_envs=size, num_threads=threads)


VECTORS: dict[str, tuple[Callable[[int], VectorEnv], int]] = {
    # Its processes are forked before there are threads.
    "Gymnasium's `AsyncVectorEnv` of `FmuEnv`": (partial(by_gymnasium, AsyncVectorEnv), 16),
    "Gymnasium's `SyncVectorEnv` of `FmuEnv`": (partial(by_gymnasium, SyncVectorEnv), 256),
}
"""How to make a vector of some size, and the largest size."""

for cores in ("1 core", "2 cores"):
    count = int(cores[0])
    in_process = partial(by_us, processes=count, in_process=True)
    VECTORS[f"`FmuVectorEnv`, in process, {cores}"] = (in_process, 4096)
    VECTORS[f"`FmuVectorEnv`, {cores}"] = (partial(by_us, processes=count), 4096)
    for task in ("CartPole-v1", "Pendulum-v1") if find_spec("envpool") else ():
        VECTORS[f"{task} of EnvPool, {cores}"] = (partial(by_envpool, task, count), 4096)


def subjects() -> Iterator[tuple[str, Callable[[], object], int]]:
    """Return what is called, by its name, and for how many environments."""
    for name, (make, largest) in VECTORS.items():
        for size in filter(lambda size: size <= largest, map(int, sys.argv[4:])):
            vector = make(size)
            vector.reset()
            actions = vector.action_space.sample()
            if len(np.atleast_1d(actions)) < size:  # EnvPool has the space of one environment
                actions = np.resize(actions, (size, *np.shape(actions)))
                actions = actions.astype(np.int32 if actions.ndim == 1 else np.float64)
            yield f"{name}/{size}", partial(vector.step, actions), size
    for name, in_process in (("`FmuEnv`, in process", True), ("`FmuEnv`", False)):
        stepped, reset = one(in_process), one(in_process)
        stepped.reset(seed=1)
        yield f"{name}/1", partial(step, stepped, np.zeros(1)), 1
        yield f"{name}/reset", reset.reset, 1


def step(env: FmuEnv, action: np.ndarray) -> None:
    """Step an environment, and begin the next episode after the last step of one."""
    *_, terminated, truncated, _ = env.step(action)
    if terminated or truncated:
        env.reset()


def cost(call: Callable[[], object], seconds: float) -> float:
    """Return the time of a call [ns]."""
    count, begin = 0, time.perf_counter_ns()
    while (spent := time.perf_counter_ns() - begin) < 1e9 * seconds or count < 2:
        call()
        count += 1
    return spent / count


def main() -> None:
    """Measure all subjects in turn, in each round."""
    rounds, seconds = int(sys.argv[2]), float(sys.argv[3])
    measured = list(subjects())
    costs: dict[str, list[float]] = {name: [] for name, *_ in measured}
    for _, call, _ in measured:
        call()
    for _ in range(rounds):
        for name, call, size in measured:
            costs[name].append(cost(call, seconds) / size)
    json.dump(costs, sys.stdout)


if __name__ == "__main__":
    main()
