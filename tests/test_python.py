"""The Python module `fmu_master`."""

import numpy as np
import pytest

from fmu_master import FmuError, System, simulate
from native import LOOPS
from native import simulate as by_command_line
from test_crashes import FAULTS, faulty

__all__ = ["faulty"]  # a fixture

PENDULUM = "target/fmu/Pendulum.fmu"


@pytest.mark.parametrize("in_process", [False, True])
def test_a_run_has_the_bits_of_the_command_line(fmus, tmp_path, in_process):
    expected = by_command_line(LOOPS / "pid.toml", tmp_path, "--set", "controller.pid.kp=250")
    system = System(LOOPS / "pid.toml")
    result = system.simulate({"controller.pid.kp": 250}, in_process=in_process)
    assert list(result) == list(expected)
    for name, column in result.items():
        np.testing.assert_array_equal(column, expected[name])
    assert result.units["plant.theta"] == "rad"


def test_a_system_of_keywords_is_that_of_a_file(fmus):
    fmu = {name: fmus / f"{name}.fmu" for name in ("Pid", "Pendulum", "Source")}
    system = System(
        components={
            "controller": {"fmu": fmu["Pid"], "start": {"previous_sample_terms": True}},
            "plant": {"fmu": fmu["Pendulum"]},
            "source": fmu["Source"],
        },
        connections=[
            ("source.r", "controller.r"),
            ("source.d", "controller.d"),
            ("plant.theta", "controller.y"),
            "controller.u -> plant.u",
        ],
        start=0.001,
        stop=1.0,
        step=0.001,
    )
    expected = System(LOOPS / "pid.toml").simulate(stop_time=1.0)
    result = system.simulate()
    for name in ("time", "plant.theta", "controller.u"):
        np.testing.assert_array_equal(result[name], expected[name])


def test_inputs_are_functions_or_arrays(fmus):
    step, force = 1e-3, 2.0
    time = np.arange(0, 1.0005, step)
    table = np.array([(0.0, force), (1.0, force)], dtype=[("time", float), ("u", float)])
    results = [
        simulate(PENDULUM, stop_time=1.0, step_size=step, input=given)
        for given in ({"u": lambda t: force}, {"time": time, "u": np.full(len(time), force)}, table)
    ]
    for result in results:
        np.testing.assert_array_equal(result["theta"], results[0]["theta"])
    assert results[0]["theta"][-1] > 0
    assert simulate(PENDULUM, stop_time=1.0)["theta"][-1] == 0


@pytest.mark.parametrize(
    ("fault", "ended"), [("CRASH", "signal 11"), ("FAIL", "returned fmi2Error")]
)
def test_a_fault_is_an_exception_with_the_rows_so_far(faulty, fault, ended):
    start = {"fault": FAULTS.index(fault), "at": 0.5}
    with pytest.raises(FmuError, match=f"Faulty.*at t = 0.5 s: fmi2DoStep.*{ended}") as caught:
        simulate(faulty, stop_time=1.0, step_size=0.125, start_values=start)
    error = caught.value
    assert (error.component, error.function, error.time) == ("Faulty", "fmi2DoStep", 0.5)
    assert error.result["time"].tolist() == [0.0, 0.125, 0.25, 0.375]


def test_what_does_not_fit_is_named(fmus):
    for options, message in (
        ({"start_values": {"M": "heavy"}}, 'M = "heavy" is invalid'),
        ({"start_values": {"m0": 1}}, "has no variable m0"),
        ({"stop_time": -1.0}, "stop = -1.0, expected at least start = 0.0"),
        ({"interface": "scripted"}, 'expected "co-simulation" or "model-exchange"'),
    ):
        with pytest.raises(FmuError, match=message):
            simulate(PENDULUM, **options)
