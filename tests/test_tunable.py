"""Tunable parameters with values from tables, and start values of arrays."""

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from fmu_master import FmuError, Instance, System, simulate
from native import printed, refusal
from test_python import PENDULUM, echo

__all__ = ["echo"]  # fixture

STEP, COUNT = 0.001, 60
GAINS = {0: (300.0, 500.0), 20: (200.0, 500.0), 21: (250.0, 0.0), 45: (250.0, 100.0)}
"""The gains of a controller from these communication points on."""


def gains(column: int) -> list[float]:
    """Return a gain at each row of a table that has one for each change."""
    return [values[column] for values in GAINS.values()]


@pytest.mark.parametrize("version", ["Pid", "Pid_fmi3"])
@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
def test_gains_of_a_table_have_the_bits_of_gains_that_are_set_by_hand(
    fmus, tmp_path, version, interface
):
    fmu, start = fmus / f"{version}.fmu", {"y": 0.1}
    names = ("pid.kp", "pid.ki")
    first = dict(zip(names, GAINS[0], strict=True))
    with Instance(fmu, interface, {**start, **first}) as pid:
        rows = [pid.get("u")]
        for k in range(COUNT):
            if k in GAINS and k:
                for name, value in zip(names, GAINS[k], strict=True):
                    pid.set(name, value)
            pid.step(STEP)
            rows.append(pid.get("u"))
    times = [k * STEP for k in GAINS]
    file = tmp_path / "gains.csv"
    lines = [f"{t},{p},{i}" for t, p, i in zip(times, gains(0), gains(1), strict=True)]
    file.write_text("\n".join(["time,pid.kp [N/rad],pid.ki", *lines]) + "\n")
    table = {"time": times, "pid.kp": gains(0), "pid.ki": gains(1)}
    parquet = tmp_path / "gains.parquet"
    pyarrow.parquet.write_table(pyarrow.table(table), parquet)
    for given in (file, parquet, table):
        result = simulate(
            fmu,
            stop_time=COUNT * STEP,
            step_size=STEP,
            start_values=start,
            input=given,
            interface=interface,
            output="u",
        )
        np.testing.assert_array_equal(result["u"], rows)
    assert rows[20] != rows[22]


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_gain_that_changes_in_a_loop_changes_the_force_of_that_sample(fmus, order):
    loop = System(
        components={
            "controller": {"fmu": fmus / "Pid.fmu"},
            "plant": {"fmu": fmus / "Pendulum.fmu", "start": {"theta0": 0.1}},
        },
        connections=[("plant.theta", "controller.y"), ("controller.u", "plant.u")],
        step=STEP,
        stop=0.1,
    )
    name = "controller.pid.kp"
    changed = loop.simulate(input={"time": [0, 0.05], name: [250.0, 200.0]}, order=order)
    before = loop.simulate({name: 250.0}, order=order)
    for output in ("controller.u", "plant.theta"):
        assert changed[output][:50].tolist() == before[output][:50].tolist()
    # The controller is sampled: its row has the output of the sample at that time.
    jump = changed["controller.u"][50] - before["controller.u"][50]
    assert jump == pytest.approx((200 - 250) * (0 - before["plant.theta"][50]))


def test_tunable_parameters_of_model_exchange_change_at_communication_points(equations):
    ball = equations / "BouncingBall.fmu"
    table = {"time": [0.0, 0.3], "e": [0.7, 1.0]}
    options = {"stop_time": 2.0, "step_size": 0.01, "interface": "model-exchange"}
    result = simulate(ball, input=table, output=["h", "v"], **options)
    with Instance(ball, "model-exchange") as by_hand:
        heights = [by_hand.get("h")]
        for k in range(200):
            if k == 30:
                by_hand.set("e", 1.0)
            by_hand.step(0.01)
            heights.append(by_hand.get("h"))
    np.testing.assert_array_equal(result["h"], heights)
    # With a coefficient of restitution of 1, the ball rises as high as it was.
    assert max(heights[100:]) == pytest.approx(heights[0], abs=0.01)


def test_arrays_and_elements_are_tunable_and_other_elements_stay(echo):
    start = {"A[1,1]": 1, "A[2,3]": 6}
    table = {"time": [0.0, 0.5], "A[1,2]": [7.0, 8.0]}
    options = {"stop_time": 1.0, "step_size": 0.25, "start_values": start}
    assert simulate(echo, input=table, **options)["yA"][-1].tolist() == [1, 8, 0, 0, 0, 6]
    whole = {"time": [0.0, 0.5], "A": [np.ones((2, 3)), np.full((2, 3), 2.0)]}
    result = simulate(echo, input=whole, stop_time=1.0, step_size=0.25)
    assert [row[0] for row in result["yA"].tolist()] == [1, 1, 1, 2, 2]


def test_only_inputs_and_tunable_parameters_have_columns(fmus, tmp_path):
    for name, reason in (
        ("theta0", "theta0 is a fixed parameter, expected an input or a tunable parameter"),
        ("theta", "theta is an output, expected an input or a tunable parameter"),
    ):
        with pytest.raises(FmuError, match=f"input: {reason}$"):
            simulate(PENDULUM, input={"time": [0, 1], name: [0.1, 0.2]})
    table = tmp_path / "nodes.csv"
    table.write_text("time,rbf.nodes\n0,4\n")
    message = refusal(tmp_path, "simulate", fmus / "PidRbf_fmi3.fmu", "--input", table)
    assert message.endswith(
        "rbf.nodes is a structural parameter, expected an input or a tunable parameter"
    )
    table.write_text("time,pid.kp\n0,4\n")
    message = refusal(tmp_path, "simulate", fmus / "Pid.fmu", "--input", table, "--set", "pid.kp=3")
    assert message.endswith("has no effect, as the table of inputs has a column for it")
    table.write_text("time,pid.kp\n0,4\n1,-2\n")
    message = refusal(tmp_path, "simulate", fmus / "Pid.fmu", "--input", table, "--stop", "2")
    assert "pid.kp = -2" in message
    assert "t = 1" in message


def test_arrays_of_fmi_2_take_lists_as_start_values(fmus, tmp_path):
    fmu = fmus / "PidRbf.fmu"
    outputs = [f"--output=rbf.w[{k}]" for k in range(1, 5)]
    csv = tmp_path / "w.csv"
    printed(
        "simulate",
        fmu,
        "--set",
        "rbf.w0=[1,2,3,4]",
        "--stop=0",
        "--step=0.001",
        "--csv",
        csv,
        *outputs,
    )
    assert csv.read_text().splitlines()[1] == "0.0,1.0,2.0,3.0,4.0"
    message = refusal(tmp_path, "simulate", fmu, "--set", "rbf.w0=[1,2]")
    assert message.endswith("rbf.w0 = [1, 2]: values: 2, expected 4")
