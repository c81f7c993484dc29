"""The controller FMUs alone, in open loop, against the independent implementation."""

import itertools
import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import reference
from pendulum_fmus.loop import TS
from pendulum_fmus.master import Component, MasterError, Reals

MODELS = ["Pid", "PidRbf", "IpidRbf"]

LEARNERS = ["PidRbf", "IpidRbf"]

NAMED = r"status 3: .*\b{}"
"""The FMU's own message about a rejected variable."""

W0 = (0.5, -0.25, 1.5, 2.0)


def input_names(model: str) -> list[str]:
    """Return the inputs in the order of the reference."""
    return ["r", "y", "d"] + (["u_supervisor"] if model == "IpidRbf" else [])


def output_names(model: str) -> list[str]:
    """Return the outputs in the order of `outputs_of`."""
    nodes = [f"rbf.{vector}[{j}]" for vector in "wh" for j in range(1, 5)]
    return ["e", "u", "u_p"] + ([] if model == "Pid" else ["u_n", *nodes])


def outputs_of(controller: reference.Controller) -> list[float]:
    """Return the outputs of the reference."""
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

    def __init__(self, component: Component):
        model = component.name
        self.component = component
        self.inputs = Reals(component, input_names(model))
        self.outputs = Reals(component, output_names(model))

    def step(self, time: float, h: float, row) -> list[float]:
        """Step with constant inputs; return the outputs."""
        self.inputs.values[:] = list(row)
        self.inputs.set()
        self.component.step(time, h)
        return self.read()

    def read(self) -> list[float]:
        """Return the outputs."""
        self.outputs.get()
        return list(self.outputs.values)


def assert_follows(probe: Probe, controller: reference.Controller, instants, rows) -> None:
    """Step both through the communication points `instants` (steps + 1,), [s]."""
    for (time, end), row in zip(itertools.pairwise(instants), rows, strict=True):
        computed = probe.step(time, end - time, row)
        controller.step(time, end - time, row)
        np.testing.assert_allclose(
            computed, outputs_of(controller), rtol=1e-9, atol=1e-9, err_msg=f"at t = {time!r}"
        )


def variants() -> list[tuple[str, dict, dict]]:
    """Return (model, start values, arguments of the reference)."""
    found = []
    for model, late, held in itertools.product(MODELS, (False, True), (False, True)):
        for target in ("own", "supervisor") if model == "IpidRbf" else ("own",):
            start = {"previous_sample_terms": late, "anti_windup": held}
            options = {**start, "target": target}
            if model != "Pid":
                start |= {f"rbf.w0[{j}]": w for j, w in enumerate(W0, start=1)}
                options["w0"] = W0
            if model == "IpidRbf":
                start["rbf.target"] = target
            found.append((model, start, options))
    return found


VARIANTS = pytest.mark.parametrize(
    ("model", "start", "options"),
    variants(),
    ids=[
        f"{model}-{options['target']}"
        + "-previous" * options["previous_sample_terms"]
        + "-anti_windup" * options["anti_windup"]
        for model, _, options in variants()
    ],
)


def follow(probe: Probe, controller: reference.Controller, h: float) -> None:
    """Check that both give the same results for half a second."""
    steps = round(0.5 / h)
    instants = [h * k for k in range(steps + 1)]
    assert_follows(probe, controller, instants, sequence(controller.kind, steps))


@VARIANTS
def test_controller_matches_the_reference(instance, model, start, options):
    follow(Probe(instance(model, start)), reference.Controller(model, **options), TS)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("h", [1 / 1024, 0.01, 0.0017])
def test_controller_matches_the_reference_at_any_step(instance, model, h):
    follow(Probe(instance(model)), reference.Controller(model), h)


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
def test_outputs_are_constant_between_samples(instance, model):
    probe, rows = Probe(instance(model)), sequence(model, 8)
    for k, row in enumerate(rows):
        outputs = probe.step(k * TS / 4, TS / 4, row)
        if k % 4 == 0:
            sampled = outputs
        assert outputs == sampled


@pytest.mark.parametrize("model", MODELS)
def test_the_force_is_zero_before_the_first_sample(instance, model):
    weights = {} if model == "Pid" else {f"rbf.w0[{j}]": w for j, w in enumerate(W0, start=1)}
    outputs = dict(zip(output_names(model), Probe(instance(model, weights)).read(), strict=True))
    assert [outputs[name] for name in ("e", "u", "u_p")] == [0, 0, 0]
    if model != "Pid":
        assert tuple(outputs[f"rbf.w[{j}]"] for j in range(1, 5)) == W0


@pytest.mark.parametrize("model", MODELS)
def test_gains_and_limits_can_be_tuned_during_a_run(instance, model):
    probe, controller = Probe(instance(model)), reference.Controller(model)
    rows = sequence(model, 400)
    changes = {100: ("kp", "pid.kp", 200.0), 150: ("ki", "pid.ki", 900.0),
               200: ("kd", "pid.kd", 50.0), 250: ("u_max", "u_max", 20.0)}  # fmt: skip
    if model != "Pid":
        changes |= {300: ("eta", "rbf.eta", 0.1), 350: ("alpha", "rbf.alpha", 0.3)}
    for k, row in enumerate(rows):
        if k in changes:
            attribute, name, value = changes[k]
            setattr(controller, attribute, value)
            probe.component.set(name, value)
        assert_follows(probe, controller, [k * TS, (k + 1) * TS], [row])


@pytest.mark.parametrize("model", LEARNERS)
def test_nodes_can_be_moved(instance, model):
    c, b = np.array([-1.5, -0.5, 0.5, 1.5]), np.array([0.3, 0.4, 0.6, 0.7])
    start = {f"rbf.{name}[{j}]": v for name, values in (("c", c), ("b", b))
             for j, v in enumerate(values, start=1)}  # fmt: skip
    controller = reference.Controller(model)
    controller.c, controller.b = c, b
    instants = [k * TS for k in range(301)]
    assert_follows(Probe(instance(model, start)), controller, instants, sequence(model, 300))


@pytest.mark.parametrize(
    ("model", "name", "value"),
    [
        ("Pid", "pid.kp", math.nan),
        ("Pid", "ts", 0.0),
        ("Pid", "u_max", -1.0),
        ("PidRbf", "rbf.b[1]", 0.0),
        ("IpidRbf", "rbf.w0[1]", math.nan),
    ],
)
def test_invalid_parameters_are_rejected_by_name(instance, model, name, value):
    with pytest.raises(MasterError, match=NAMED.format(re.escape(name))):
        instance(model, {name: value})


# --- any communication steps --------------------------------------------------------------------

SPAN = 20
"""Samples of the property test."""

finite = st.floats(-2, 2)


@given(
    cuts=st.lists(st.floats(0, SPAN * TS), max_size=30),
    row=st.tuples(finite, finite, finite, st.floats(-100, 100)),
)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@pytest.mark.parametrize("model", MODELS)
def test_any_sequence_of_steps_gives_the_same_samples(fmus, model, cuts, row):
    row = row[: len(input_names(model))]
    instants = [0.0, *sorted(cuts), SPAN * TS]
    with Component(model, fmus / f"{model}.fmu") as a, Component(model, fmus / f"{model}.fmu") as b:
        regular, irregular = Probe(a), Probe(b)
        a.initialize(0.0)
        b.initialize(0.0)
        for k in range(SPAN):
            expected = regular.step(k * TS, TS, row)
        for time, end in itertools.pairwise(instants):
            computed = irregular.step(time, end - time, row)
    assert computed == expected
