"""Table 1 of the paper from co-simulations, and further behaviour of the loops."""

import math
from decimal import Decimal

import numpy as np
import pytest

from pendulum_fmus import table1
from pendulum_fmus.loop import STEPS, TS, Loop
from pendulum_fmus.master import simulate
from pendulum_fmus.table1 import Entry, agrees, rounded
from side_by_side import assert_close, both

ENTRIES = table1.entries()


def name(entry: Entry) -> str:
    """Return the name of the test of an entry."""
    return "-".join([*entry.label, "settling"] if entry.settling else entry.label)


def test_there_are_18_numbers_4_with_fitted_weights_and_2_settling_times():
    assert len(ENTRIES) == 18 + 4 + 2
    assert sum(entry.settling for entry in ENTRIES) == 2
    # All except rows 1 and 2 of PidRbf and the sine rows of the networks with zero weights
    assert sum(entry.every_digit for entry in ENTRIES) == 18 - 2 - 4 + 4 + 2


@pytest.mark.parametrize("entry", ENTRIES, ids=name)
def test_number(table_results, entry):
    computed = entry.computed(table_results[entry.run])
    assert entry.close(computed), f"{computed!r} is not close to {entry.expected!r}"
    if entry.every_digit:
        assert rounded(computed, entry.printed) == Decimal(entry.printed)


def test_the_report_confirms_every_number(table_results):
    text, all_hold = table1.report(table_results)
    assert all_hold
    assert text.count(" ok\n") + text.count(" (ok)\n") == len(ENTRIES)
    assert "18 of 18 numbers of Table 1 reproduced, 12 to every digit" in text
    assert max(map(len, text.splitlines())) <= 80
    assert "MISSED" not in text


def test_the_report_shows_misses(table_results):
    run = Loop("Pid", "step", 0.0)
    wrong = {**table_results[run], "controller.e": np.array([-1.97e-3])}
    text, all_hold = table1.report({**table_results, run: wrong})
    assert not all_hold
    assert text.count("MISSED") == 1


@pytest.mark.parametrize(
    ("value", "printed", "agreed"),
    [
        (-1.963846e-3, "-0.0020", True),
        (-1.949e-3, "-0.0020", False),
        (8.2377058e-4, "8.2377e-4", True),
        (8.25470e-4, "8.2377e-4", False),
        (3.839, "3.8", True),
        (math.nan, "3.8", False),
        (math.inf, "3.8", False),
    ],
)
def test_rounding_to_the_printed_digits(value, printed, agreed):
    assert agrees(value, printed) == agreed


def test_own_target_leaves_a_small_static_error(fmus):
    computed, expected = both(fmus, "IpidRbf", "step", steps=STEPS)
    error = computed["controller.e"]
    assert np.ptp(error[-5000:]) < 1e-9
    assert error[-1] == pytest.approx(expected["controller.e"][-1], abs=1e-11)
    assert error[-1] == pytest.approx(-1.0e-5, rel=0.02)  # e of one sign: u ramps up forever


@pytest.mark.parametrize("controller", ["PidRbf", "IpidRbf"])
def test_parallel_stepping_is_well_behaved_with_current_terms(fmus, controller):
    computed, expected = both(
        fmus, controller, "step",
        order="parallel", previous_sample_terms=False, steps=STEPS,
    )  # fmt: skip
    assert_close(computed, expected, 1e-10)
    assert np.max(np.abs(computed["controller.e"][10000:])) < 2e-5


def test_one_sample_of_delay_is_equivalent_in_master_and_controller(fmus):
    parallel, _ = both(fmus, "PidRbf", order="parallel", previous_sample_terms=False, steps=8000)
    sequential, _ = both(fmus, "PidRbf", order="sequential", previous_sample_terms=True, steps=8000)
    difference = parallel["plant.theta"] - sequential["plant.theta"]
    assert np.max(np.abs(difference)) < 1e-9


RINGING = 1.0
"""A force that changes by more than this per sample, long after the step, is ringing [N]."""


def largest_change(u: np.ndarray) -> float:
    """Return the change per sample of the force u [N], shape (steps,), near its end."""
    return float(np.max(np.abs(np.diff(u[-500:]))))


@pytest.mark.parametrize("controller", ["PidRbf", "IpidRbf"])
def test_two_samples_of_delay_end_in_a_limit_cycle(fmus, controller):
    with Loop(controller, previous_sample_terms=True).system(fmus) as system:
        results = simulate(system, TS, TS, STEPS, order="parallel")
    assert largest_change(results["controller.u"]) > RINGING
    assert 1e-3 < np.max(np.abs(results["controller.e"][-2000:])) < 0.1  # bounded, not converged


@pytest.mark.parametrize(("factor", "stable"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize(
    ("order", "late", "limit"),
    [
        ("sequential", False, 0.582),
        ("sequential", True, 0.324),
        ("parallel", False, 0.324),
        ("parallel", True, 0.205),
    ],
)
def test_learning_is_stable_up_to_the_limit_set_by_the_delay(
    fmus, order, late, limit, factor, stable
):
    """The limits are eigenvalues of the linear sampled loop, for r = 1."""
    rate = (("controller.rbf.eta", factor * limit),)
    loop = Loop("PidRbf", previous_sample_terms=late, overrides=rate)
    with loop.system(fmus) as system:
        results = simulate(system, TS, TS, 12000, order=order, record=["controller.u"])
    assert (largest_change(results["controller.u"]) < RINGING) == stable
