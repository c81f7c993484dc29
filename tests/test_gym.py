"""Environments of Gymnasium: `fmu_master.gym`."""

import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import scipy.linalg
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from fmu_master import FmuError, Instance, System, python_component
from fmu_master.gym import FmuEnv, FmuVectorEnv
from native import in_c, read, write
from pendulum_fmus.project import ROOT
from test_crashes import FAULTS, faulty
from test_engineering import FORCE_ON_PLANT, PLANT
from test_python import echo

__all__ = ["echo", "faulty"]  # fixtures

PENDULUM = ROOT / "target" / "fmu" / "Pendulum.fmu"
IN_PROCESS = pytest.mark.parametrize("in_process", [False, True], ids=["child", "in_process"])


# --- one environment ------------------------------------------------------------------------------


@pytest.mark.parametrize("prefix", ["", "plant."])
@pytest.mark.parametrize("in_process", [False, True])
def test_the_environment_is_one_of_gymnasium_and_falls_as_the_closed_form(fmus, prefix, in_process):
    plant = fmus / "Pendulum.fmu"
    meter = python_component(["x"], ["y"], lambda t, x: 100 * x)
    loop = System(
        components={"plant": plant, "meter": meter},
        connections=[("plant.x", "meter.x")],
        step=0.01,
        stop=1.0,
    )
    make = partial(
        FmuEnv,
        loop if prefix else plant,
        actions={f"{prefix}u": (-100.0, 100.0)},
        observations={f"{prefix}theta": (-0.2, 0.2), f"{prefix}omega": (-5.0, 5.0)},
        reward=lambda observation, action: -(observation[0] ** 2),
        stop_time=0.5,
        start=lambda random: {f"{prefix}theta0": random.uniform(-0.05, 0.05)},
        in_process=in_process,
    )
    if prefix:
        with pytest.raises(ValueError, match=r"step_size = 0.015, expected a multiple of 0.01 s"):
            make(step_size=0.015).reset()
    env = make(step_size=0.01)
    check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=5)
    np.testing.assert_array_equal(env.reset(seed=5)[0], first)
    state, force = env.reset(options={f"{prefix}theta0": 0.1})[0], 2.0
    assert state == pytest.approx([0.1, 0])
    both = np.block([[PLANT, FORCE_ON_PLANT], [np.zeros((1, 5))]])
    ends = []
    for k in range(1, 51):
        state, reward, terminated, truncated, info = env.step(np.array([force]))
        expected = scipy.linalg.expm(both * 0.01 * k) @ [0.1, 0, 0, 0, force]
        np.testing.assert_allclose(state, expected[:2], rtol=1e-9)
        assert reward == pytest.approx(-(expected[0] ** 2))
        assert terminated == bool(abs(expected[0]) > 0.2 or abs(expected[1]) > 5)
        ends.append(truncated)
    assert ends == [False] * 49 + [True]
    assert info["time"] == pytest.approx(0.5)
    env.close()
    with pytest.raises(FmuError, match="has no variable force"):
        env.reset(options={f"{prefix}force": 1.0})
    with pytest.raises(RuntimeError, match="expected a call of reset first"):
        env.step(np.array([0.0]))


def waiting(plant: Path | str) -> FmuEnv:
    """Return an environment whose run waits for an action."""
    env = FmuEnv(
        System(components={"plant": plant}, connections=[], step=0.01, stop=1.0),
        actions={"plant.u": (-1.0, 1.0)},
        observations={"plant.theta": (-0.2, 0.2)},
        reward=lambda observation, action: 0.0,
        step_size=0.01,
        stop_time=0.5,
    )
    env.reset()
    return env


def test_an_environment_that_is_dropped_ends_its_run(fmus):
    before = set(threading.enumerate())
    env = waiting(fmus / "Pendulum.fmu")
    (run,) = set(threading.enumerate()) - before
    del env
    run.join(10)
    assert not run.is_alive()


def test_an_environment_that_is_never_closed_lets_python_end(fmus):
    code = "import sys, test_gym; env = test_gym.waiting(sys.argv[1])"
    plant = (fmus / "Pendulum.fmu").absolute()
    subprocess.run([sys.executable, "-c", code, plant], check=True, cwd=ROOT / "tests")


BALANCE = {
    "actions": {"u": (-100.0, 100.0)},
    "observations": {"theta": (-0.2, 0.2), "omega": (-5.0, 5.0)},
    "reward": lambda observations, actions: -(observations[..., 0] ** 2) - actions[..., 0],
    "step_size": 0.01,
    "stop_time": 0.3,
    "start": lambda random: {"theta0": random.uniform(-0.15, 0.15)},
}
"""Environments of which some terminate and others are truncated."""


def episode(env: gymnasium.Env, **reset) -> list[np.ndarray]:
    """Return the observations of an episode with random actions."""
    observations = [env.reset(**reset)[0]]
    random = np.random.default_rng(1)
    terminated = truncated = False
    while not (terminated or truncated):
        observation, _, terminated, truncated, _ = env.step(random.uniform(-100, 100, 1))
        observations.append(observation)
    return observations


@IN_PROCESS
@pytest.mark.parametrize("fmu", ["Pendulum.fmu", "Pendulum_fmi3.fmu"])
def test_an_episode_in_a_kept_fmu_has_the_bits_of_the_first(fmus, fmu, in_process):
    env = FmuEnv(fmus / fmu, **BALANCE, in_process=in_process)
    episode(env, seed=1, options={"l": 0.3, "dynamics": "nonlinear"})
    kept = episode(env, seed=2)
    np.testing.assert_array_equal(kept, episode(FmuEnv(fmus / fmu, **BALANCE), seed=2))
    env.close()


@IN_PROCESS
def test_an_fmu_that_cannot_be_reset_begins_each_episode_anew(tmp_path, in_process):
    env = FmuEnv(
        in_c(tmp_path / "Hopper.fmu"),
        actions={"a[1]": (-20.0, 20.0), "a[2]": (-20.0, 20.0), "n": (0.0, 1000.0)},
        observations={"h": (-1.0, 100.0), "landings": (0.0, 9.0)},
        reward=lambda observation, action: observation[0],
        step_size=0.1,
        stop_time=1.0,
        in_process=in_process,
    )
    height = 0.1 * np.arange(1, 4) * (1.0 - 0.5 * 4.0 * 0.1 * np.arange(1, 4))
    for _ in range(2):
        env.reset()
        rows = [env.step([-6.0, 1.0, 1000.0])[0] for _ in height]
        np.testing.assert_allclose(rows, np.transpose([height, 0 * height]), atol=1e-9)
    with pytest.raises(ValueError, match=r"n = 0.5 is invalid; expected a 32-bit integer"):
        env.step([-6.0, 1.0, 0.5])
    env.close()


def test_an_action_of_a_wrong_shape_or_not_finite_is_refused(fmus):
    env = FmuEnv(PENDULUM, **BALANCE)
    env.reset()
    with pytest.raises(ValueError, match=r"^2 actions, expected 1$"):
        env.step([1, 2])
    with pytest.raises(ValueError, match=r"^action = 1.0, expected an array of 1$"):
        env.step(1.0)
    with pytest.raises(ValueError, match=r"^u = NaN, expected a finite number$"):
        env.step([np.nan])
    env.step([1.0])
    env.close()


@pytest.mark.parametrize("make", [partial(FmuVectorEnv, num_envs=2), FmuEnv])
def test_arguments_that_do_not_fit_are_refused_by_their_names(fmus, make):
    with pytest.raises(ValueError, match="actions has no variable, expected at least one"):
        make(PENDULUM, **{**BALANCE, "actions": {}})
    with pytest.raises(ValueError, match=r"step_size = 0.0, stop_time = 0.3, expected a positive"):
        make(PENDULUM, **{**BALANCE, "step_size": 0.0})
    with pytest.raises(FmuError, match="has no variable thet; did you mean theta"):
        make(PENDULUM, **{**BALANCE, "observations": {"thet": (-1.0, 1.0)}}).reset()


def test_arrays_and_texts_are_no_actions(echo):
    given = {**BALANCE, "start": lambda random: {}, "observations": {"yi": (-9.0, 9.0)}}
    with pytest.raises(FmuError, match="ws is an array, expected one of its 2 elements"):
        FmuVectorEnv(echo, 1, **{**given, "actions": {"ws": (0.0, 1.0)}})
    env = FmuVectorEnv(echo, 2, **{**given, "actions": {"i": (-9.0, 9.0)}})
    env.reset()
    np.testing.assert_array_equal(env.step([[3], [-4]])[0], [[3.0], [-4.0]])
    env.close()


def test_structural_parameters_are_start_values_of_all_environments(tmp_path):
    fmu = in_c(tmp_path / "Vector.fmu")
    given = {
        "actions": {"u": (-1.0, 1.0)},
        "observations": {"w[3]": (0.0, 100.0)},
        "reward": lambda observations, actions: observations[..., 0],
        "step_size": 0.5,
        "stop_time": 1.0,
    }
    largest = {**given, "observations": {"w[5]": (0.0, 100.0)}}
    env = FmuEnv(fmu, **largest, start=lambda random: {"n": 5})
    for options, expected in (({"n": 6}, 5.0), ({}, 5.0), ({"c": [0, 0, 0, 0, 4.0]}, 4.0)):
        env.reset(options=options)
        env.step([0.0])
        assert env.step([0.0])[0] == expected
    env.close()
    sizes = iter([4, 4, 4, 5])
    vector = FmuVectorEnv(fmu, 2, **given, start=lambda random: {"n": next(sizes)})
    vector.reset()
    np.testing.assert_array_equal(vector.step([[0.0], [0.0]])[0], [[1.5], [1.5]])
    with pytest.raises(FmuError, match="n: structural parameters, expected the same in all env"):
        vector.reset()
    vector.close()


# --- vectors --------------------------------------------------------------------------------------


def rollout(env: gymnasium.vector.VectorEnv, steps: int = 80) -> list[tuple]:
    """Return all that an environment returns for random actions; seeds are 7, 8, ..."""
    random = np.random.default_rng(1)
    results = [env.reset(seed=7)]
    over = np.zeros(env.num_envs, bool)
    for _ in range(steps):
        if env.metadata["autoreset_mode"] == AutoresetMode.DISABLED and over.any():
            results.append(env.reset(options={"reset_mask": over}))
        results.append(env.step(random.uniform(-100, 100, (env.num_envs, 1))))
        over = results[-1][2] | results[-1][3]
    env.close()
    return results


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize(("in_process", "processes"), [(False, 2), (True, 1), (True, 3)])
def test_a_vector_has_the_bits_of_its_environments(fmus, mode, in_process, processes):
    make = partial(FmuEnv, PENDULUM, **BALANCE, in_process=True)
    expected = rollout(SyncVectorEnv([make] * 7, autoreset_mode=mode))
    own = {"processes": processes, "in_process": in_process, "autoreset_mode": mode}
    found = rollout(FmuVectorEnv(PENDULUM, 7, **BALANCE, **own))
    ends = [result[2:4] for result in expected if len(result) == 5]
    assert np.any([terminated for terminated, _ in ends])
    assert np.any([truncated for _, truncated in ends])
    for theirs, ours in zip(expected, found, strict=True):
        assert data_equivalence(theirs, ours, exact=True), (theirs, ours)


@IN_PROCESS
def test_a_vector_falls_as_the_closed_form_and_as_an_instance(fmus, in_process):
    angles, forces = np.linspace(-0.1, 0.1, 5), np.linspace(-3.0, 2.0, 5)
    starts = iter(angles)
    wide = {"theta": (-9.0, 9.0), "omega": (-99.0, 99.0)}
    start = {"start": lambda random: {"theta0": next(starts)}}
    given = {**BALANCE, **start, "observations": wide}
    env = FmuVectorEnv(PENDULUM, 5, **given, in_process=in_process)
    env.reset()
    for _ in range(20):
        observations, rewards, _, _, infos = env.step(forces[:, None])
    both = np.block([[PLANT, FORCE_ON_PLANT], [np.zeros((1, 5))]])
    begin = np.stack([angles, *np.zeros((3, 5)), forces])
    expected = (scipy.linalg.expm(both * 0.2) @ begin)[:2].T
    np.testing.assert_allclose(observations, expected, rtol=1e-9)
    np.testing.assert_array_equal(rewards, -(observations[:, 0] ** 2) - forces)
    assert infos["time"] == pytest.approx(np.full(5, 0.2))
    env.close()
    for angle, force, observation in zip(angles, forces, observations, strict=True):
        with Instance(PENDULUM, start_values={"theta0": angle}, in_process=True) as plant:
            plant.initialize()
            for _ in range(20):
                plant.set("u", force)
                plant.step(0.01)
            np.testing.assert_array_equal(observation, plant.get(["theta", "omega"]))


def test_seeds_and_start_values_of_a_reset_are_those_of_gymnasium(fmus):
    env = FmuVectorEnv(PENDULUM, 3, **BALANCE)
    first, infos = env.reset(seed=5)
    assert env.np_random_seed == (5, 6, 7)
    assert len(env.np_random) == 3
    assert data_equivalence(infos, {"time": np.zeros(3), "_time": np.ones(3, bool)})
    np.testing.assert_array_equal(env.reset(seed=[7, 6, 5])[0], first[::-1])
    np.testing.assert_array_equal(env.reset(options={"theta0": 0.1})[0][:, 0], [0.1] * 3)
    mask = np.array([False, True, False])
    env.step(np.zeros((3, 1)))
    again, infos = env.reset(seed=4, options={"reset_mask": mask})
    np.testing.assert_array_equal(again[1], first[0])
    np.testing.assert_array_equal(infos["_time"], mask)
    env.close()


def test_a_vector_is_made_by_gymnasium_and_wrapped_by_its_wrappers(fmus):
    gymnasium.register("Fmu-v0", entry_point=FmuEnv, vector_entry_point=FmuVectorEnv)
    try:
        env = gymnasium.make_vec("Fmu-v0", num_envs=4, fmu=PENDULUM, **BALANCE)
    finally:
        gymnasium.registry.pop("Fmu-v0")
    assert env.observation_space.shape == (4, 2)
    assert env.single_action_space == FmuEnv(PENDULUM, **BALANCE).action_space
    wrapped = RecordEpisodeStatistics(env)
    wrapped.reset(seed=1)
    lengths = []
    for _ in range(40):
        infos = wrapped.step(wrapped.action_space.sample())[-1]
        lengths += infos["episode"]["l"][infos["_episode"]].tolist() if "episode" in infos else []
    assert max(lengths) <= 30
    assert len(lengths) >= 4
    wrapped.close()


def test_what_a_vector_cannot_do_is_refused(fmus):
    make = partial(FmuVectorEnv, PENDULUM, 2, **BALANCE)
    for number in (0, -1):
        with pytest.raises(ValueError, match=f"num_envs = {number}, expected at least 1"):
            FmuVectorEnv(PENDULUM, number, **BALANCE)
    with pytest.raises(ValueError, match="processes = -1, expected at least 1, or 0"):
        make(processes=-1)
    with pytest.raises(TypeError, match=r"use gymnasium.vector.SyncVectorEnv of FmuEnv"):
        FmuVectorEnv(System(PENDULUM), 2, **BALANCE)
    env = make()
    with pytest.raises(RuntimeError, match="environment 0 has no episode, expected a call of res"):
        env.step(np.zeros((2, 1)))
    env.reset()
    with pytest.raises(ValueError, match=r"actions of the shape \(1, 2\), expected \(2, 1\)"):
        env.step(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="environment 1: u = inf, expected a finite number"):
        env.step([[0.0], [np.inf]])
    with pytest.raises(TypeError, match="reset_mask = True, expected an array of Booleans"):
        env.reset(options={"reset_mask": True})
    with pytest.raises(ValueError, match=r"reset_mask = .*, with at least one True"):
        env.reset(options={"reset_mask": np.zeros(2, bool)})
    with pytest.raises(ValueError, match="3 seeds, expected 2"):
        env.reset(seed=[1, 2, 3])
    with pytest.raises(FmuError, match="has no variable theta9; did you mean theta or theta0"):
        env.reset(options={"theta9": 0.1})
    env.reset()
    env.close()
    for use in (env.reset, lambda: env.step(np.zeros((2, 1)))):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="is closed"):
            use()


def test_a_reward_for_one_environment_is_refused_by_a_vector(fmus):
    reward = lambda observation, action: -(observation[0] ** 2)  # noqa: E731
    env = FmuVectorEnv(PENDULUM, 3, **{**BALANCE, "reward": reward})
    env.reset()
    with pytest.raises(ValueError, match=r"reward returns the shape \(2,\), expected \(3,\)"):
        env.step(np.zeros((3, 1)))
    env.close()


def test_episodes_that_are_over_must_be_reset_if_nothing_else_does_it(fmus):
    env = FmuVectorEnv(PENDULUM, 2, **{**BALANCE, "stop_time": 0.01}, autoreset_mode="Disabled")
    env.reset(options={"theta0": 0.0})
    env.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError, match="episodes of environments 0, 1 are over, expected a re"):
        env.step(np.zeros((2, 1)))
    env.close()


def failing(file: Path, fault: str, **options) -> FmuVectorEnv:
    """Return environments of which number 2 fails in its first episode at t = 0.5 s."""
    faults = iter([0, 0, FAULTS.index(fault)])
    return FmuVectorEnv(
        file,
        4,
        actions={"at": (0.0, 1.0)},
        observations={"y": (-1.0, 2.0)},
        reward=lambda observations, actions: observations[:, 0],
        step_size=0.25,
        stop_time=1.0,
        start=lambda random: {"fault": next(faults, 0)},
        **options,
    )


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("CRASH", "was ended by signal 11, illegal memory access"),
        ("EXIT_AT_ONCE", "exited with code 3 before it had finished"),
        ("FAIL", "returned fmi2Error"),
    ],
)
def test_a_failure_names_the_instance_and_a_reset_starts_it_again(faulty, fault, said):
    env = failing(faulty, fault, processes=2)
    env.reset()
    actions = np.full((4, 1), 0.5)
    for _ in range(2):
        env.step(actions)
    with pytest.raises(FmuError) as failure:
        env.step(actions)
    where = "Faulty[2] (Faulty.fmu), step of 0.25 s at t = 0.5 s: fmi2DoStep "
    assert str(failure.value) == f"{where}{said}; the FMU logged no reason"
    assert failure.value.component == "Faulty[2]"
    with pytest.raises(RuntimeError, match="has no episode, expected a call of reset first"):
        env.step(actions)
    env.reset()
    for _ in range(3):
        observations = env.step(actions)[0]
    np.testing.assert_array_equal(observations, np.full((4, 1), 0.75))
    env.close()


def test_a_failure_in_this_process_keeps_the_other_instances(faulty):
    env = failing(faulty, "FAIL", processes=2, in_process=True)
    env.reset()
    actions = np.full((4, 1), 0.5)
    for _ in range(2):
        env.step(actions)
    with pytest.raises(FmuError, match=r"Faulty\[2\] .* at t = 0.5 s: fmi2DoStep returned fmi2E"):
        env.step(actions)
    env.reset()
    np.testing.assert_array_equal(env.step(actions)[0], np.full((4, 1), 0.25))
    env.close()


def test_an_fmu_with_one_instance_in_a_process_needs_a_process_for_each(tmp_path):
    fmu = in_c(tmp_path / "Faulty.fmu")
    files = read(fmu)
    flag = b'<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" '
    text = files["modelDescription.xml"].replace(b"<CoSimulation ", flag)
    write(fmu, {**files, "modelDescription.xml": text})
    refused = r"Faulty.fmu allows only one instance in a process, expected processes = 4"
    for options in ({"processes": 2}, {"processes": 4, "in_process": True}):
        with pytest.raises(FmuError, match=refused):
            failing(fmu, "NONE", **options)
    env = failing(fmu, "NONE", processes=4)
    env.reset()
    np.testing.assert_array_equal(env.step(np.zeros((4, 1)))[0], np.full((4, 1), 0.25))
    env.close()


@IN_PROCESS
def test_a_forked_process_is_told_that_the_vector_is_not_its_own(fmus, in_process):
    env = FmuVectorEnv(PENDULUM, 4, **BALANCE, processes=2, in_process=in_process)
    env.reset()
    child = os.fork()
    if child == 0:
        try:
            env.step(np.zeros((4, 1)))
        except FmuError as error:
            os._exit(0 if "from which this one was forked" in str(error) else 2)
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    env.step(np.zeros((4, 1)))
    env.close()


def test_a_vector_that_is_never_closed_leaves_no_process_thread_or_file(fmus, tmp_path):
    code = f"""
import numpy as np, test_gym
for in_process in (False, True):
    env = test_gym.FmuVectorEnv({str(PENDULUM)!r}, 5, **test_gym.BALANCE, in_process=in_process)
    env.reset()
    env.step(np.zeros((5, 1)))
"""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", code]
    subprocess.run(command, check=True, cwd=ROOT / "tests", env=environment, timeout=60)
    assert list(tmp_path.iterdir()) == []
