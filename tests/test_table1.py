"""Table 1 of the paper from co-simulations, and the loops with more delay."""

import math
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest

from pendulum_fmus import table1
from pendulum_fmus.loop import STEPS, Loop, execute
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


def test_the_report_confirms_every_number_and_shows_misses(table_results):
    text, all_hold = table1.report(table_results)
    assert all_hold
    assert text.count(" ok\n") + text.count(" (ok)\n") == len(ENTRIES)
    assert "18 of 18 numbers of Table 1 reproduced, 12 to every digit" in text
    assert max(map(len, text.splitlines())) <= 80
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


@pytest.mark.parametrize(
    "loop", [Loop("Pid", "square", 1.0), Loop("IpidRbf", "square", 1.0, "supervisor")]
)
def test_the_fmus_of_fmi_3_give_the_same_bits(fmus, table_results, loop):
    columns = execute(replace(loop, fmi3=("all",)), fmus)
    for name, column in table_results[loop].items():
        assert columns[name].tobytes() == column.tobytes(), name


def test_own_target_leaves_a_small_static_error(fmus):
    error = execute(Loop("IpidRbf"), fmus)["controller.e"]
    assert np.ptp(error[-5000:]) < 1e-9
    assert error[-1] == pytest.approx(-1.0e-5, rel=0.02)  # e of one sign: u ramps up forever


@pytest.mark.parametrize("controller", ["PidRbf", "IpidRbf"])
def test_parallel_stepping_is_well_behaved_with_current_terms(fmus, controller):
    options = {"order": "parallel", "previous_sample_terms": False, "steps": 12000}
    computed, expected = both(fmus, controller, "step", **options)
    assert_close(computed, expected, 1e-10)
    assert np.max(np.abs(computed["controller.e"][10000:])) < 2e-5


@pytest.mark.parametrize("controller", ["PidRbf", "IpidRbf"])
def test_two_samples_of_delay_end_in_a_limit_cycle(fmus, controller):
    loop = Loop(controller, order="parallel", previous_sample_terms=True, steps=STEPS)
    results = execute(loop, fmus)
    assert np.max(np.abs(np.diff(results["controller.u"][-500:]))) > 1  # still ringing
    assert 1e-3 < np.max(np.abs(results["controller.e"][-2000:])) < 0.1  # bounded, not converged
