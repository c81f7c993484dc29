"""One FMU that Python steps by hand: `fmu_master.Instance`."""

import ast
import inspect
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_master import FmuError, Instance, simulate
from native import SECONDS, in_c
from test_crashes import FAULTS, faulty
from test_python import LARGEST, ODD, PENDULUM, echo

__all__ = ["echo", "faulty"]  # fixtures


@pytest.fixture(params=[False, True], ids=["child", "in_process"])
def plant(fmus, request):
    """Return a pendulum that is stepped by hand."""
    with Instance(PENDULUM, start_values={"theta0": 0.1}, in_process=request.param) as plant:
        yield plant


def test_steps_by_hand_have_the_bits_of_a_run(plant):
    step, count, force = 1e-3, 200, 2.0
    expected = simulate(
        PENDULUM,
        stop_time=step * count,
        step_size=step,
        start_values={"theta0": 0.1},
        input={"u": lambda t: force},
    )
    rows = [plant.get(["theta", "x"])]
    plant.set("u", force)
    for _ in range(count):
        plant.step(step)
        rows.append(plant.get(["theta", "x"]))
    assert plant.time == pytest.approx(step * count)
    columns = np.array(rows).T
    np.testing.assert_array_equal(columns[0], expected["theta"])
    np.testing.assert_array_equal(columns[1], expected["x"])


def test_a_restored_state_repeats_the_same_steps(plant):
    plant.step(0.05)
    state, time = plant.save(), plant.time

    def steps() -> list[float]:
        plant.restore(state)
        assert plant.time == time
        plant.step(0.05)
        return plant.get(["theta", "omega", "x", "v"]).tolist()

    assert steps() == steps()
    assert plant.variables["theta"].unit == "rad"
    assert plant.variables["M"].start == 1.096


def test_a_reset_begins_again_with_the_start_values_that_were_set_before(plant):
    plant.set("v0", 0.5)
    first = plant.get(["theta", "v"]).tolist()
    plant.set("u", 3.0)
    plant.step(0.05)
    after = plant.get(["theta", "v"]).tolist()
    for _ in range(2):
        plant.reset()
        assert (plant.time, plant.get(["theta", "v", "u"]).tolist()) == (0.0, [*first, 0.0])
        plant.set("u", 3.0)
        plant.step(0.05)
        assert plant.get(["theta", "v"]).tolist() == after
    plant.reset({"theta0": -0.2, "u": 1.0})
    assert plant.get(["theta", "v", "u"]).tolist() == [-0.2, 0.5, 1.0]
    for wrong, message in (
        ({"theta9": 1.0}, "has no variable theta9"),
        ({"theta0": "steep"}, 'theta0 = "steep" is invalid'),
        ([0.1], r"start values \[0.1\], expected a dict from names to values"),
    ):
        with pytest.raises((FmuError, TypeError), match=message):
            plant.reset(wrong)
    assert plant.get("theta") == -0.2


def test_a_state_is_restored_also_after_a_reset(plant):
    plant.step(0.05)
    state, values = plant.save(), plant.get(["theta", "omega"]).tolist()
    plant.reset({"theta0": 0.3})
    for _ in range(2):
        plant.restore(state)
        assert (plant.time, plant.get(["theta", "omega"]).tolist()) == (0.05, values)
        plant.step(0.05)
        plant.reset()
        assert plant.get("theta") == 0.3


def test_an_instance_that_has_failed_runs_again_after_a_reset(plant):
    plant.set("u", 1e308)
    with pytest.raises(FmuError, match=r"returned fmi2Error: .* became inf"):
        plant.initialize()
    plant.reset({"u": 0.0})
    plant.step(0.1)
    assert (plant.time, plant.get("u")) == (0.1, 0.0)


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("ending", ["", "_fmi3"])
def test_a_reset_begins_again_with_the_first_event(equations, ending, interface):
    with Instance(equations / f"Stair{ending}.fmu", interface, start_time=0.0) as stair:
        for _ in range(2):
            stair.step(2.0)
            assert stair.get("counter") == 3
            stair.reset()


def test_a_step_by_model_exchange_can_be_repeated_after_a_failure(tmp_path):
    refuse = "static int refused; if (c->a[0] > 0 && !refused++) return 2"
    fmu = in_c(tmp_path / "Hopper.fmu", f"ON_DERIVATIVES={refuse}")
    with Instance(fmu, in_process=True) as hopper:
        for step in (math.nan, -0.1, 0.0):
            with pytest.raises(FmuError, match=r"step = .* expected a positive number"):
                hopper.step(step)
        hopper.set("a", [2.0, 0.0])  # lifts the ball
        with pytest.raises(FmuError, match="returned fmi3Discard"):
            hopper.step(0.3)
        hopper.step(0.3)
        assert hopper.get("h") == pytest.approx(0.09, abs=1e-9)
        assert hopper.time == 0.3


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("ending", ["", "_fmi3"])
def test_events_at_both_ends_of_a_step_belong_to_it(equations, ending, interface):
    with Instance(equations / f"Stair{ending}.fmu", interface=interface) as stair:
        for second in range(1, 4):
            assert stair.get("counter") == second
            stair.step(1.0)
    with Instance(equations / f"Thermostat{ending}.fmu", interface=interface) as room:
        room.step(1.0)
        room.set("set_point", 30.0)
        room.step(1.0)
        assert room.get("temperature") == pytest.approx(45 - 25 * math.exp(-1 / 50), abs=1e-6)
        room.set("window", True)
        temperature = room.get("temperature")
        room.step(1.0)
        opened = 25 + (temperature - 25) * math.exp(-1 / 10)
        assert room.get("temperature") == pytest.approx(opened, abs=1e-6)


SHARED = """
import sys, threading
from fmu_master import Instance

with Instance(sys.argv[1], in_process=sys.argv[2] == "True") as plant:
    plant.initialize()
    calls = lambda: plant.step(0.001), plant.save, lambda: plant.get("theta")
    for call in calls:
        threading.Thread(target=lambda call=call: [call() for _ in range(1000)]).start()
    while threading.active_count() > 1:
        plant.save()
"""


@pytest.mark.parametrize("in_process", [False, True])
def test_threads_that_share_an_instance_do_not_wait_for_each_other_forever(fmus, in_process):
    command = [sys.executable, "-c", SHARED, PENDULUM, str(in_process)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(command, env=env, timeout=SECONDS, check=True)


def test_what_does_not_fit_is_named(fmus):
    with Instance(PENDULUM) as one, Instance(PENDULUM) as other:
        state = one.save()
        other.save()
        with pytest.raises(FmuError, match="the state is of another instance"):
            other.restore(state)
    for value, count in ((5.0, 1), ([1.0, 2.0], 2)):
        message = rf"rbf\.w0 = .*: values: {count}, expected 4"
        with Instance("target/fmu/PidRbf_fmi3.fmu", in_process=True) as controller:
            with pytest.raises(FmuError, match=message):
                controller.set("rbf.w0", value)
            with pytest.raises(FmuError, match="nodes is a structural parameter, expected in"):
                controller.set("rbf.nodes", 2)
            controller.set("rbf.w0", np.arange(4.0))
            controller.set("rbf.w0[2]", 7.0)
            assert controller.get("rbf.w0").tolist() == [0.0, 7.0, 2.0, 3.0]
            with pytest.raises(FmuError, match=message):
                controller.set({"rbf.w0": value})
    seeds = pytest.raises(FmuError, match="the seed has 1 numbers, expected 2")
    with Instance(PENDULUM, in_process=True) as plant, seeds:
        plant.directional_derivative(["omega"], ["u", "theta"], [1.0])


def test_a_crash_of_an_instance_is_an_exception(faulty):
    start = {"fault": FAULTS.index("CRASH"), "at": 0.5}
    with Instance(faulty, start_values=start) as instance:
        instance.step(0.25)
        instance.step(0.25)
        with pytest.raises(FmuError, match=r"signal 11") as caught:
            instance.step(0.25)
        assert (caught.value.component, caught.value.function) == ("Faulty", "fmi2DoStep")
        assert caught.value.time == 0.5
        with pytest.raises(FmuError, match="was freed"):
            instance.step(0.25)


@pytest.mark.parametrize("in_process", [False, True])
def test_whole_numbers_of_64_bits_keep_all_digits_in_an_instance(echo, in_process):
    start = {"w": LARGEST, "i": -ODD, "ws": [1, 2**63]}
    with Instance(echo, start_values=start, in_process=in_process) as instance:
        assert (instance.get("yw"), instance.get("yi")) == (LARGEST, -ODD)
        assert instance.get("yws").tolist() == [1, 2**63]
        for given in (2**63 + 1, np.uint64(ODD), np.int32(7), np.array(LARGEST, np.uint64)):
            instance.set("w", given)
            assert instance.get("yw") == int(given)
            assert instance.get(["yw", "yi", "yA[1,1]"]).tolist() == [int(given), -ODD, 0.0]
        for array in ([2**63 + 1, 0], (1, np.uint64(LARGEST)), np.array([ODD, 2**63], np.uint64)):
            instance.set("ws", array)
            assert instance.get("yws").tolist() == list(array)
        for wrong in (-1, 2**64, 1.5):
            with pytest.raises(FmuError, match=rf"w = .*; expected .* from 0 to {LARGEST}"):
                instance.set("w", wrong)


@pytest.mark.parametrize("in_process", [False, True])
def test_an_array_has_the_shape_of_its_variable(echo, in_process):
    matrix = np.arange(6.0).reshape(2, 3)
    with Instance(echo, start_values={"A": matrix}, in_process=in_process) as instance:
        np.testing.assert_array_equal(instance.get("yA"), matrix)
        for _ in range(3):  # also with the reply to a step
            instance.set({"A": matrix + 1, "ws": [1, 2]})
            instance.step(0.5)
            np.testing.assert_array_equal(instance.get("yA"), matrix + 1)
            assert instance.get("yws").tolist() == [1, 2]
            assert instance.get(["yA[1,2]", "yA"]).tolist() == [2, 1, 2, 3, 4, 5, 6]
            assert instance.get_list(["yA[2,1]", "yw"]) == [4.0, 0]
    controller = "target/fmu/PidRbf_fmi3.fmu"
    start = {"rbf.nodes": 1, "rbf.c": [0.5], "rbf.b": [0.5], "rbf.w0": [0.0]}
    with Instance(controller, start_values=start, in_process=in_process) as single:
        assert single.get("rbf.c").tolist() == [0.5]
        single.reset({"rbf.nodes": 1, "rbf.c": [0.25]})
        assert single.get("rbf.c").tolist() == [0.25]
        with pytest.raises(FmuError, match=r"rbf\.nodes is a structural parameter, expected in"):
            single.reset({"rbf.nodes": 2})


REFUSED = [
    (PENDULUM, "u", "1", r"u = \"1\" is invalid; expected a number .*N\]"),
    (PENDULUM, "u", True, r"u = true is invalid; expected a number"),
    (PENDULUM, "u", np.bool_(True), r"u = true is invalid; expected a number"),
    (PENDULUM, "u", None, r"u(: None is not| = None is invalid; expected) a number"),
    (PENDULUM, "u", 1j, r"u(: 1j is not| = 1j is invalid; expected) a number"),
    (PENDULUM, "u", [1.0], r"u = \[1\.0\] is invalid; expected a number"),
    ("Echo", "w", "1", r"w = \"1\" is invalid; expected a whole number from 0"),
    ("Echo", "w", 1.0, r"w = 1\.0 is invalid; expected a whole number from 0"),
    ("Echo", "w", True, r"w = true is invalid; expected a whole number from 0"),
    ("Echo", "ws", ["1", "2"], r"ws\[1\] = \"1\" is invalid; expected a whole number from 0"),
    ("Echo", "ws", "[1, 2]", r"ws = \[.*\]: values: 1, expected 2"),
    (
        "target/fmu/PidRbf.fmu",
        "previous_sample_terms",
        1,
        r"= 1 is invalid; expected true or false",
    ),
    (
        "target/fmu/PidRbf.fmu",
        "previous_sample_terms",
        "true",
        r"\"true\" is invalid; expected true",
    ),
]
"""FMUs, variables and values that Python must not confuse, and what is said of them."""


@pytest.mark.parametrize(("fmu", "name", "value", "message"), REFUSED)
def test_a_value_of_another_type_is_refused(fmus, echo, fmu, name, value, message):
    fmu = echo if fmu == "Echo" else fmu
    with pytest.raises((FmuError, TypeError), match=message):
        Instance(fmu, start_values={name: value}, in_process=True)
    with Instance(fmu, in_process=True) as instance:
        for change in (
            lambda: instance.set(name, value),
            lambda: instance.reset({name: value}),
            lambda: [instance.initialize(), instance.set({name: value})],
        ):
            with pytest.raises(FmuError, match=message):
                change()


def test_numbers_of_numpy_and_whole_numbers_are_set(plant):
    for value in (1, 1.0, np.float64(1), np.float32(1), np.int32(1), np.array(1.0), np.uint8(1)):
        plant.set("u", 0.0)
        plant.set("u", value)
        assert plant.get("u") == 1.0
        plant.initialize()


def test_a_loop_in_a_child_has_the_values_of_one_in_this_process(fmus):
    """Values that were got after a step come with the next one, unless something was set since."""
    rows = []
    for in_process in (False, True):
        with Instance(PENDULUM, start_values={"theta0": 0.1}, in_process=in_process) as plant:
            rows.append([])
            for step in range(30):
                plant.set("u", 0.1 * step)
                if step % 7 == 3:
                    rows[-1].append(plant.get("u"))
                if step % 5:
                    plant.step(0.01)
                names = ["theta", "omega"][step % 3 :]
                rows[-1] += [plant.time, plant.get("theta"), *plant.get([*names, "u"])]
                if step == 20:
                    state = plant.save()
            plant.restore(state)
            rows[-1] += [plant.time, *plant.get(["theta", "omega", "u"])]
    assert rows[0] == rows[1]


def test_a_value_that_the_fmu_refuses_by_its_description_is_an_error_of_set(fmus):
    with Instance(PENDULUM) as plant:
        plant.step(0.001)
        for value in (math.nan, math.inf):
            with pytest.raises(
                FmuError, match=r"u = .* at t = 0\.001 s: fmi2SetReal returned fmi2"
            ):
                plant.set("u", value)
    with Instance("target/fmu/PidRbf.fmu", "co-simulation") as controller:
        controller.step(0.001)
        variables = controller.variables.values()
        low = next(v for v in variables if v.min is not None and v.variability == "tunable")
        with pytest.raises(FmuError, match=rf"{low.name}.* returned fmi2"):
            controller.set(low.name, low.min - 1.0)


def test_another_value_that_the_fmu_refuses_is_an_error_of_the_call_that_sends_it(tmp_path):
    fmu = in_c(tmp_path / "Echo.fmu", "ON_SET=if (count == 1 && values[0] == 13) return 3")
    with Instance(fmu) as instance:
        for call in (lambda: instance.step(0.5), lambda: instance.get("yw"), instance.save):
            instance.step(0.5)
            time = instance.time
            instance.set({"w": 13, "i": 7})
            with pytest.raises(FmuError, match=r"w = 13 .*fmi3SetUInt64 returned fmi3Error"):
                call()
            assert (instance.time, instance.get_list(["yw", "yi"])) == (time, [0, 0])


def test_a_value_that_cannot_be_got_is_no_error_of_the_step(tmp_path):
    fmu = in_c(tmp_path / "Echo.fmu", "ON_GET=static int got; if (++got == 3) return 3")
    with Instance(fmu) as instance:
        for count in range(1, 6):
            instance.set("w", count)
            instance.step(0.5)
            assert (instance.time, instance.get("yw")) == (0.5 * count, count)


def test_functions_of_rust_have_the_documentation_of_their_types():
    native = Instance.__bases__[0]
    tree = ast.parse(Path(inspect.getfile(Instance)).with_name("_native.pyi").read_text())
    declared = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "Instance")
    found = {f.name: ast.get_docstring(f) for f in declared.body if ast.get_docstring(f)}
    assert found == {name: inspect.getdoc(getattr(native, name)) for name in found}
    assert set(found) == {"time", "set", "step", "get", "free"}
