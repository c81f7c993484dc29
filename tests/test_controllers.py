"""The controller FMUs alone, in open loop, against the independent implementation."""

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import reference
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, Reals

MODELS = ["Pid", "PidRbf", "IpidRbf"]

W0 = (0.5, -0.25, 1.5, 2.0)


def vector(name: str, values: Iterable[float]) -> dict[str, float]:
    """Return the elements of a vector as start values."""
    return {f"rbf.{name}[{j}]": value for j, value in enumerate(values, start=1)}


def outputs_of(controller: reference.Controller) -> list[float]:
    """Return the outputs of the reference in the order of `Probe`."""
    c = controller
    return [c.e, c.u, c.u_p] + ([] if c.kind == "Pid" else [c.u_n, *c.w, *c.h])


def sequence(model: str, steps: int) -> np.ndarray:
    """Return inputs (steps, 3 or 4) that reach the nodes and sometimes the force limit."""
    rng = np.random.default_rng(11)
    r = np.repeat(rng.uniform(-2, 2, steps // 20 + 1), 20)[:steps]
    y = np.cumsum(rng.normal(0, 3e-4, steps))
    d = rng.choice([0.0, 0.1], steps)
    columns = [r, y, d] + ([rng.uniform(-50, 50, steps)] if model == "IpidRbf" else [])
    return np.column_stack(columns)


class Probe:
    """A controller FMU whose inputs and outputs are accessed as whole rows."""

    def __init__(self, component: Component, nodes: int = 4):
        model = component.name
        self.component = component
        supervised = ["u_supervisor"] * (model == "IpidRbf")
        self.inputs = Reals(component, ["r", "y", "d", *supervised])
        network = (
            []
            if model == "Pid"
            else ["u_n", *vector("w", range(nodes)), *vector("h", range(nodes))]
        )
        self.outputs = Reals(component, ["e", "u", "u_p", *network])

    def step(self, time: float, h: float, row: Sequence[float]) -> list[float]:
        """Step with constant inputs; return the outputs."""
        self.inputs.values[:] = list(row)
        self.inputs.set()
        self.component.step(time, h)
        self.outputs.get()
        return list(self.outputs.values)


def follow(
    probe: Probe, controller: reference.Controller, rows: np.ndarray, h: float = TS, first: int = 0
) -> None:
    """Check that both give the same results for a row of inputs per step of h [s]."""
    for k, row in enumerate(rows, start=first):
        time, end = h * k, h * (k + 1)
        computed = probe.step(time, end - time, row)
        controller.step(time, end - time, row)
        np.testing.assert_allclose(
            computed, outputs_of(controller), rtol=1e-9, atol=1e-9, err_msg=f"at t = {time!r}"
        )


FLAGS = ("previous_sample_terms", "anti_windup")


@pytest.mark.parametrize("flags", [*itertools.product((False, True), repeat=2)], ids=str)
@pytest.mark.parametrize("target", ["own", "supervisor"])
@pytest.mark.parametrize("model", MODELS)
def test_controller_matches_the_reference(instance, model, target, flags):
    options = dict(zip(FLAGS, flags, strict=True))
    start = options | ({"rbf.target": target} if model == "IpidRbf" else {})
    if model != "Pid":
        start |= vector("w0", W0)
        options["w0"] = W0
    if target == "own" or model == "IpidRbf":
        controller = reference.Controller(model, target=target, **options)
        follow(Probe(instance(model, start)), controller, sequence(model, 500))


@pytest.mark.parametrize("h", [1 / 1024, 0.01, 0.0017])
@pytest.mark.parametrize("model", MODELS)
def test_controller_matches_the_reference_at_any_step(instance, model, h):
    rows = sequence(model, round(0.3 / h))
    follow(Probe(instance(model)), reference.Controller(model), rows, h)


@pytest.mark.parametrize("model", MODELS)
def test_a_later_start_time_only_shifts_the_results(instance, model):
    rows = sequence(model, 300)
    early, late = Probe(instance(model)), Probe(instance(model, time=1e6))
    for k, row in enumerate(rows):
        assert early.step(k * TS, TS, row) == late.step(1e6 + k * TS, TS, row)


@pytest.mark.parametrize("jitter", [0.0, 1e-13, -1e-13])
def test_accumulated_time_neither_skips_nor_repeats_a_sample(instance, jitter):
    steady, shaken, time = Probe(instance("PidRbf")), Probe(instance("PidRbf")), 0.0
    for k, row in enumerate(sequence("PidRbf", 5000)):
        expected = steady.step(k * TS, TS, row)
        assert shaken.step(time, TS + jitter, row) == expected, k
        time += TS + jitter


@pytest.mark.parametrize("model", MODELS)
def test_the_force_is_zero_before_the_first_sample(instance, model):
    probe = Probe(instance(model, {} if model == "Pid" else vector("w0", W0)))
    probe.outputs.get()
    values = list(probe.outputs.values)
    assert values[:3] == [0, 0, 0]
    assert tuple(values[4:8]) in ((), W0)


@pytest.mark.parametrize("model", MODELS)
def test_gains_and_limits_can_be_tuned_during_a_run(instance, model):
    probe, controller = Probe(instance(model)), reference.Controller(model)
    changes = {"kp": ("pid.kp", 200.0), "ki": ("pid.ki", 900.0), "kd": ("pid.kd", 50.0),
               "u_max": ("u_max", 20.0)}  # fmt: skip
    if model != "Pid":
        changes |= {"eta": ("rbf.eta", 0.1), "alpha": ("rbf.alpha", 0.3)}
    rows = np.split(sequence(model, 60 * len(changes)), len(changes))
    for part, (attribute, (name, value)) in enumerate(changes.items()):
        setattr(controller, attribute, value)
        probe.component.set(name, value)
        follow(probe, controller, rows[part], first=60 * part)


CENTRES = [-1.5, -0.5, 0.5, 1.5, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0]


@pytest.mark.parametrize("nodes", [1, 3, 4, 10])
@pytest.mark.parametrize("model", MODELS[1:])
def test_networks_of_any_size_agree_with_the_reference(fmus, model, nodes):
    """The number of nodes is a structural parameter of FMI 3.0; FMI 2.0 has four."""
    w0, c = [0.5 * j for j in range(1, nodes + 1)], CENTRES[:nodes]
    b = [0.3 + 0.1 * j for j in range(nodes)]
    start = {"rbf.nodes": nodes, **vector("w0", w0), **vector("c", c), **vector("b", b)}
    expected = reference.Controller(model, w0=w0)
    expected.c, expected.b, expected.h = np.array(c), np.array(b), np.zeros(nodes)
    with Component(model, fmus / f"{model}_fmi3.fmu", start) as controller:
        assert f"rbf.w[{nodes}]" in controller.outputs()
        assert f"rbf.w[{nodes + 1}]" not in controller.outputs()
        controller.initialize(0.0)
        rows = sequence(model, 300)
        follow(Probe(controller, nodes), expected, 3 * rows if nodes > 4 else rows)


# --- any communication steps --------------------------------------------------------------------

SPAN = 20
"""Samples of the property test."""

finite = st.floats(-2, 2)


@given(
    cuts=st.lists(st.floats(0, SPAN * TS), max_size=30),
    row=st.tuples(finite, finite, finite, st.floats(-100, 100)),
)
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.parametrize("model", MODELS)
def test_any_sequence_of_steps_gives_the_same_samples(fmus, model, cuts, row):
    instants = [0.0, *sorted(cuts), SPAN * TS]
    with Component(model, fmus / f"{model}.fmu") as a, Component(model, fmus / f"{model}.fmu") as b:
        regular, irregular = Probe(a), Probe(b)
        a.initialize(0.0)
        b.initialize(0.0)
        row = row[: len(regular.inputs.names)]
        for k in range(SPAN):
            expected = regular.step(k * TS, TS, row)
        for time, end in itertools.pairwise(instants):
            computed = irregular.step(time, end - time, row)
    assert math.isfinite(sum(computed))
    assert computed == expected
