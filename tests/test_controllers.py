"""The controller FMUs alone, in open loop, against the independent implementation."""

import itertools
from collections.abc import Iterable

import numpy as np
import pytest

import reference
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, Reals

CONTROLLERS = ["Pid", "PidRbf", "IpidRbf"]

W0 = (0.5, -0.25, 1.5, 2.0)


def vector(name: str, values: Iterable[float]) -> dict[str, float]:
    """Return the elements of a vector as start values."""
    return {f"rbf.{name}[{j}]": value for j, value in enumerate(values, start=1)}


def sequence(model: str, steps: int) -> np.ndarray:
    """Return inputs (steps, 3 or 4) that reach the nodes and sometimes the force limit."""
    rng = np.random.default_rng(11)
    r = np.repeat(rng.uniform(-2, 2, steps // 20 + 1), 20)[:steps]
    y = np.cumsum(rng.normal(0, 3e-4, steps))
    d = rng.choice([0.0, 0.1], steps)
    columns = [r, y, d] + ([rng.uniform(-50, 50, steps)] if model == "IpidRbf" else [])
    return np.column_stack(columns)


def follow(
    component: Component,
    law: reference.Controller,
    rows: np.ndarray,
    first: int = 0,
    nodes: int = 4,
) -> None:
    """Check that both give the same results for a row of inputs per sample."""
    inputs = Reals(component, ["r", "y", "d", *["u_supervisor"] * (law.kind == "IpidRbf")])
    names = ["e", "u", "u_p"]
    if law.kind != "Pid":
        names += ["u_n", *vector("w", range(nodes)), *vector("h", range(nodes))]
    outputs = Reals(component, names)
    for k, row in enumerate(rows, start=first):
        time, end = TS * k, TS * (k + 1)
        inputs.values[:] = list(row)
        inputs.set()
        component.step(time, end - time)
        law.step(time, end - time, row)
        outputs.get()
        expected = [law.e, law.u, law.u_p]
        if law.kind != "Pid":
            expected += [law.u_n, *law.w, *law.h]
        np.testing.assert_allclose(list(outputs.values), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("flags", [*itertools.product((False, True), repeat=2)], ids=str)
@pytest.mark.parametrize(
    ("model", "target"), [*((model, "own") for model in CONTROLLERS), ("IpidRbf", "supervisor")]
)
def test_controller_matches_the_reference(instance, model, target, flags):
    options = dict(zip(("previous_sample_terms", "anti_windup"), flags, strict=True))
    start = options | ({"rbf.target": target} if model == "IpidRbf" else {})
    if model != "Pid":
        start |= vector("w0", W0)
        options["w0"] = W0
    component = instance(model, start)
    assert [component.get(name) for name in ("e", "u", "u_p")] == [0, 0, 0]  # no sample so far
    follow(component, reference.Controller(model, target=target, **options), sequence(model, 500))


@pytest.mark.parametrize("model", CONTROLLERS)
def test_gains_and_limits_can_be_tuned_during_a_run(instance, model):
    component, law = instance(model), reference.Controller(model)
    changes = {"pid.kp": 200.0, "pid.ki": 900.0, "pid.kd": 50.0, "u_max": 20.0}
    if model != "Pid":
        changes |= {"rbf.eta": 0.1, "rbf.alpha": 0.3}
    rows = np.split(sequence(model, 60 * len(changes)), len(changes))
    for part, (name, value) in enumerate(changes.items()):
        setattr(law, name.split(".")[-1], value)
        component.set(name, value)
        follow(component, law, rows[part], first=60 * part)


CENTRES = [-1.5, -0.5, 0.5, 1.5, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0]


@pytest.mark.parametrize("nodes", [1, 3, 4, 10])
@pytest.mark.parametrize("model", CONTROLLERS[1:])
def test_networks_of_any_size_agree_with_the_reference(fmus, model, nodes):
    """The number of nodes is a structural parameter of FMI 3.0; FMI 2.0 has four."""
    w0, c = [0.5 * j for j in range(1, nodes + 1)], CENTRES[:nodes]
    b = [0.3 + 0.1 * j for j in range(nodes)]
    start = {"rbf.nodes": nodes, **vector("w0", w0), **vector("c", c), **vector("b", b)}
    law = reference.Controller(model, w0=w0)
    law.c, law.b, law.h = np.array(c), np.array(b), np.zeros(nodes)
    with Component(model, fmus / f"{model}_fmi3.fmu", start) as controller:
        assert f"rbf.w[{nodes}]" in controller.outputs()
        assert f"rbf.w[{nodes + 1}]" not in controller.outputs()
        controller.initialize(0.0)
        rows = sequence(model, 300)
        follow(controller, law, 3 * rows if nodes > 4 else rows, nodes=nodes)
