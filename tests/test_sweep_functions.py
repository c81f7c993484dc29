"""Sweeps of systems with components in Python."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from dask.distributed import Client

from fmu_master import FmuError, Sweep, System, python_component, sweep
from sweeps import journal_of

PENDULUM = "target/fmu/Pendulum.fmu"
PLAN = {"plant.theta0": [0.02 * k for k in range(1, 9)]}


class Pd:
    """A controller whose state is its last input."""

    def __init__(self, kp: float = 300.0):
        self.kp = kp
        self.reset()

    def reset(self) -> None:
        """Forget the last input."""
        self.last, self.history = 0.0, []

    def step(self, time: float, y: float) -> tuple[float, float]:
        """Return the force and the error."""
        rate, self.last = (y - self.last) / 0.001, y
        self.history.append(y)
        return -self.kp * y - 30.0 * rate, -y

    __call__ = step


def closure(kp: float = 300.0):
    """Return a function that keeps the last input in a variable that it has captured."""
    last, log = 0.0, []

    def step(time: float, y: float) -> tuple[float, float]:
        nonlocal last
        rate, last = (y - last) / 0.001, y
        log.append(np.sign(rate))  # also of a module
        return -kp * y - 30.0 * rate, -y

    return step


LAST = 0.0


def reset_globally() -> None:
    global LAST
    LAST = 0.0


def globally(time: float, y: float) -> tuple[float, float]:
    """Compute the force with a state in a global variable."""
    global LAST
    rate, LAST = (y - LAST) / 0.001, y
    return -300.0 * y - 30.0 * rate, -y


class Locked(Pd):
    """A controller that cannot be copied."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        super().__init__()


def system(step, **options) -> System:
    """Return the loop of a controller in Python and the plant."""
    return System(
        components={
            "controller": python_component(["y"], ["u", "e"], step, **options),
            "plant": PENDULUM,
        },
        connections=[("plant.theta", "controller.y"), ("controller.u", "plant.u")],
        step=0.001,
        stop=0.1,
    )


SIGNALS = {
    "reference": "plant.x",
    "output": "plant.theta",
    "error": "controller.e",
    "control": "controller.u",
}


def sampled(loop: System, plan: dict = PLAN, **options) -> dict:
    return sweep(plan, loop, signals=SIGNALS, **options)


@pytest.fixture(scope="module")
def expected(fmus) -> dict[str, list[float]]:
    """Return what separate runs with a controller each have."""
    found: dict[str, list[float]] = {"final_e": [], "largest_u": []}
    for theta in PLAN["plant.theta0"]:
        result = system(Pd().step).simulate({"plant.theta0": theta})
        found["final_e"].append(result["controller.e"][-1])
        found["largest_u"].append(np.max(np.abs(result["controller.u"])))
    return found


@pytest.mark.parametrize("processes", [1, 3])
def test_runs_have_the_bits_of_separate_ones_wherever_the_state_is(expected, processes):
    used, closed, locked = Pd(), closure(), Locked()
    used.step(0.0, 0.5)  # a state that `reset` ends
    for step, reset in (
        (used.step, used.reset),
        (Pd(), None),
        (closed, None),
        (globally, reset_globally),
        (locked.step, locked.reset),
        (lambda t, y, own=Pd(): own.step(t, y), None),  # noqa: B008, a state of its own
    ):
        runs = sampled(system(step, reset=reset), processes=processes)
        assert runs["failure"].tolist() == [None] * 8
        for name, values in expected.items():
            assert runs[name].tolist() == values, (step, name)


def test_the_state_of_a_function_is_the_same_after_a_sweep(fmus):
    controller = Pd()
    sampled(system(controller.step))
    assert (controller.last, controller.history) == (0.0, [])


def test_an_exception_is_the_failure_of_its_run(fmus):
    def step(time: float, y: float) -> tuple[float, float]:
        if time > 0.05 and y > 0.1:
            raise ZeroDivisionError(f"no force at {y > 0.1}")
        return 0.0, -y

    runs = sampled(system(step), {"plant.theta0": [0.01, 0.2, 0.02]})
    failures = runs["failure"].tolist()
    assert failures[::2] == [None, None]
    assert failures[1] == (
        "controller (Python), step of 0.001 s at t = 0.051000000000000004 s: the function failed: "
        "ZeroDivisionError: no force at True"
    )
    assert runs["diverged"].tolist() == [False, True, False]
    message = "2 of 2 runs failed, the first was run 0: controller .*: ZeroDivisionError: no force"
    with pytest.raises(FmuError, match=message):
        sampled(system(step), {"plant.theta0": [0.2, 0.3]})


def test_an_interrupt_ends_the_sweep_and_leaves_no_file(fmus, tmp_path):
    def step(time: float, y: float) -> tuple[float, float]:
        if time > 0.05:
            raise KeyboardInterrupt
        return 0.0, -y

    out = tmp_path / "out.csv"
    with pytest.raises(KeyboardInterrupt):
        sampled(system(step), out=out)
    assert list(tmp_path.iterdir()) == []


def test_what_a_sweep_cannot_do_with_a_function_is_refused(fmus, tmp_path):
    lock = threading.Lock()
    cannot = r"controller: the function cannot be copied \(TypeError: cannot pickle .*lock.*`reset`"
    for step, message in (
        (Locked().step, cannot),
        (lambda t, y: (float(lock.locked()), -y), cannot),
        (globally, "controller: the function changes global variables, expected `reset`"),
    ):
        with pytest.raises(FmuError, match=message):
            sampled(system(step))
    swept = Sweep(PLAN, system(Pd().step), signals=SIGNALS)
    refused = pytest.raises(FmuError, match="controller is a function of Python, expected `run`,")
    with Client(processes=False, dashboard_address="127.0.0.1:0") as client, refused:
        swept.dask(client)
    out = tmp_path / "out.csv"

    def reset() -> None:
        raise RuntimeError("no reset")

    with pytest.raises(RuntimeError, match="no reset"):
        sampled(system(Pd().step, reset=reset), out=out)
    # The rows of a sweep that was killed may be those of another function.
    sampled(system(Pd().step), out=out)
    journal = journal_of(out)
    journal.write_text("# sweep 0\n")
    with pytest.raises(FmuError, match=r"out.csv.part belongs to another sweep"):
        sampled(system(Pd().step), out=out)


def test_functions_of_several_components_and_a_parameter_in_python(fmus):
    """Each run has both functions; inputs of functions can be parameters, too."""
    total = python_component(["u", "bias"], ["y", "e"], lambda t, u, bias: (u + bias, u))

    def counted(time: float, counts: list[float] = [-1.0]) -> float:  # noqa: B006, its state
        counts.append(counts[-1] + 1)
        return counts[-1]

    ramp = python_component([], ["y"], counted)
    loop = System(
        components={"ramp": ramp, "sum": total, "plant": PENDULUM},
        connections=[("ramp.y", "sum.u")],
        step=0.5,
        stop=2.0,
    )
    signals = {"reference": "ramp.y", "output": "ramp.y", "error": "sum.e", "control": "sum.y"}
    runs = sweep({"sum.bias": [0.0, 10.0, 20.0]}, loop, signals=signals)
    assert runs["largest_u"].tolist() == [4.0, 14.0, 24.0]
    assert runs["final_e"].tolist() == [4.0] * 3
    assert counted(0.0) == 0


def test_threads_take_turns_to_run_a_loaded_system_with_a_function(expected):
    controller = Pd()
    component = system(controller.step, reset=controller.reset)
    with component.loaded() as loaded, ThreadPoolExecutor(4) as pool:
        starts = [{"plant.theta0": theta} for theta in PLAN["plant.theta0"]]
        results = list(pool.map(loaded.simulate, starts))
    assert [result["controller.e"][-1] for result in results] == expected["final_e"]
