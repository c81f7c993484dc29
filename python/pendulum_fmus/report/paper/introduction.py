"""Abstract and introduction: what the paper promises, and how fast the controllers respond."""

import math

import numpy as np

from ..claims import Claim, Finding, Row
from ..data import Data, Trace
from ..figure import ANGLE, FORCE, Curve, Figure, Panel
from ..metrics import rms
from ..scenarios import KINDS
from ..stability import LAWS, RAMP, growth
from .compare import (
    COLUMNS,
    IPID,
    OTHERS,
    PID,
    RBF,
    Measure,
    better,
    by_signal,
    limited,
    row,
    settles,
)
from .curves import SHOWN, outputs
from .entry import Entry
from .measures import (
    ADJUSTMENT,
    EFFORT,
    GROWTH,
    INTERFERENCE,
    LATE,
    OVERSHOOT,
    PEAK,
    ROBUSTNESS,
    SPEED,
    accuracy,
    returns,
)

TRACKED = 0.05
"""An error that stays below this is tracking [rad]."""

LOST = 0.5
"""A pendulum with a larger error no longer stands [rad]."""

RAIL = 10.0
"""A cart that stays within this is somewhere near the pendulum's place [m]."""

TAKEN_OVER = 0.1
"""RMS of u_p relative to u below which the network has taken over."""


ONE_MORE = "rate of the fastest growing mode, one sample more [1/s]"
"""Name of the row for one more sample of delay."""


def lasting(data: Data, kind: str) -> float:
    """Return the time at which the pendulum is lost after a step, infinite if never [s]."""
    long = data.lasting(kind)
    lost = np.flatnonzero((np.abs(long["e"]) > LOST) & (long["t"] > 20))
    return float(long["t"][lost[0]]) if lost.size else math.inf


def saturated(data: Data) -> float:
    """Return the time at which the force of PID-RBF has ramped to its limit [s]."""
    long = data.lasting("PID-RBF")
    return float(long["t"][np.flatnonzero((np.abs(long["u"]) >= 100) & (long["t"] > 20))[0]])


LASTING = Measure("pendulum lost, step [s]", lasting, more=True)

CART = Measure("cart’s distance after 20 s, step [m]", lambda data, kind: abs(data.x_end(kind)))


def stable_tracking(data: Data) -> Claim:
    """Return the statement that the pendulum tracks its set-point stably."""

    def finding(ipid: str) -> Finding:
        kinds = ["PID-RBF", ipid]
        rows = []
        for measure in LATE:
            values = measure.values(data)
            rows.append(row(measure.name, values, all(values[k] < TRACKED for k in kinds)))
        lost, cart = LASTING.values(data), CART.values(data)
        rows.append(row(LASTING.name, lost, all(math.isinf(lost[k]) for k in kinds)))
        rows.append(row(CART.name, cart, all(cart[k] < RAIL for k in kinds)))
        return Finding(
            COLUMNS,
            rows,
            "To hold 1 rad the cart must keep accelerating, and the force must fall by"
            f" {RAMP:.2f} N every second to overcome the growing friction. With PID-RBF it reaches"
            f" the limit of ±100 N after {saturated(data):.0f} s, and within a second the pendulum"
            " falls. Without that limit Table 1 cannot be reproduced.",
        )

    return Claim(
        "Abstract: “realizes the stable tracking for the inverted pendulum system”",
        f"PID-RBF and IPID-RBF: in the last second |e| is below {TRACKED:g} rad, with each"
        f" signal; |e| of a step stays below {LOST:g} rad for 110 s; the cart stays within 10 m",
        finding,
    )


def adaptive(data: Data) -> Claim:
    """Return the statement that the network takes over."""

    def share(trace: Trace) -> float:
        late = trace.part(19.0, 21.0)
        return rms(late.u_p) / rms(late.u)

    rows = by_signal(
        data, "RMS(u_p)/RMS(u)", "1", share, lambda v: v["PID-RBF"] < TAKEN_OVER, KINDS[1:]
    )
    return Claim(
        "Abstract: PID-RBF “realizes the adaptive adjustment of the stable tracking signal”",
        "from 19 s on the RMS of the PID’s part of the force is below 10 % of the whole, since the"
        " network has taken over, with each signal",
        lambda _: Finding(COLUMNS, rows),
    )


def always(_: str) -> Finding:
    """Return the fastest growing modes with one sample of delay more."""
    rates = [growth(law, 1) for law in LAWS.values()]
    return Finding(COLUMNS, [Row(ONE_MORE, rates, max(rates) < 0)])


def ensured(data: Data) -> Claim:
    """Return the statement that PID-RBF ensures the stability."""

    def finding(_: str) -> Finding:
        rates = [growth(LAWS["PID-RBF"], samples) for samples in (0, 1)]
        lost = LASTING.values(data)
        return Finding(
            ["PID-RBF"],
            [
                Row(
                    "rate of the fastest growing mode, as in Table 1 [1/s]", rates[:1], rates[0] < 0
                ),
                Row(ONE_MORE, rates[1:], rates[1] < 0),
                Row(LASTING.name, [lost["PID-RBF"]], math.isinf(lost["PID-RBF"])),
            ],
        )

    return Claim(
        "Innovation 1: “PID-RBF strategy ensures the stability of the system.”",
        "all modes of the sampled loop at r = 1 decay, also with one sample of delay more; a step"
        " is held for 110 s",
        finding,
    )


def claims(data: Data) -> list[Claim]:
    """Return the statements of abstract and introduction, in the paper's order."""
    return [
        stable_tracking(data),
        adaptive(data),
        better(
            data,
            "Abstract: with IPID-RBF “the response speed of the system is further improved”",
            [*SPEED, *ADJUSTMENT],
            IPID,
            RBF,
            "By every measure of how fast the pendulum gets there, IPID-RBF is the slowest of the"
            " three; its rise time is twice that of PID-RBF. It is faster only in settling.",
            [PEAK],
        ),
        better(
            data,
            "Abstract: with IPID-RBF “the overshoot of the tracking signal is further reduced”",
            OVERSHOOT,
            IPID,
            RBF,
        ),
        Claim(
            "Introduction: “no matter what the control system is, the system will tend to be stable"
            " under the action of the controller”",
            "all modes of the sampled loop at r = 1 decay if one more sample passes between"
            " measurement and force",
            always,
        ),
        ensured(data),
        better(data, "Innovation 1: “The overshoot of the system is reduced”", OVERSHOOT, RBF, PID),
        better(
            data,
            "Innovation 1: “the robustness of the system is enhanced”",
            ROBUSTNESS,
            RBF,
            PID,
            "Margins of the sampled loop at r = 1. The network adds an integrator that is nearly"
            " as fast as the loop allows; the FMUs ring at the same delays"
            " (section “Noise and delay”).",
        ),
        settles(
            data,
            "Innovation 1: “In the case of interference, the parameters can be adjusted adaptively"
            " to control signal tracking.”",
            RBF,
            returns(),
            "PID-RBF settles within each band between the end of the pulse and 10 s, in each case",
        ),
        limited(
            data,
            "Innovation 2: IPID-RBF “further solves the problem of large overshoot in the control"
            " process”",
            IPID,
            [(measure, 2.0) for measure in OVERSHOOT[:2]],
        ),
        better(
            data,
            "Innovation 2: “The adjustment time of the system is further reduced.”",
            ADJUSTMENT,
            IPID,
            OTHERS,
        ),
        better(
            data,
            "Innovation 2: “This strategy has strong anti-interference ability”",
            INTERFERENCE,
            IPID,
            OTHERS,
        ),
        better(data, "Innovation 2: “fast stability”", ADJUSTMENT, IPID, OTHERS),
        better(
            data, "Innovation 2: “small error with the tracking curve”", accuracy(), IPID, OTHERS
        ),
        better(
            data,
            "Innovation 3: replacing PID by PID-RBF “can make the system overshoot smaller”",
            OVERSHOOT,
            RBF,
            PID,
        ),
        better(
            data,
            "Innovation 3: “and system stability better”",
            [*ADJUSTMENT, GROWTH, *ROBUSTNESS],
            RBF,
            PID,
        ),
        better(
            data,
            "Innovation 3: “IPID-RBF strategy further improves the overall performance of the"
            " system.”",
            [SPEED[0], ADJUSTMENT[2], OVERSHOOT[0], *accuracy(), *EFFORT],
            IPID,
            RBF,
        ),
        better(
            data,
            "Innovation 3: with IPID-RBF “the system has a faster response speed”",
            SPEED,
            IPID,
            OTHERS,
        ),
        better(
            data,
            "Innovation 3: with IPID-RBF the system has “better stability”",
            [*ADJUSTMENT, GROWTH],
            IPID,
            OTHERS,
            "Supervised as in Table 1, IPID-RBF is a PD controller with a force from another loop"
            " added to it. A PD controller does not stabilize this plant: its slowest mode grows,"
            f" by a factor of e in {1 / growth(LAWS['IPID-RBF']):.0f} s.",
        ),
        better(
            data,
            "Innovation 3: with IPID-RBF the system has better “robustness”",
            ROBUSTNESS,
            IPID,
            OTHERS,
            "The margins are those of the loop of IPID-RBF alone, not counting its mode that grows"
            " slowly. Its supervisor is a PID-RBF loop, with the margins of PID-RBF.",
        ),
    ]


def held(data: Data, column: str) -> list[Curve]:
    """Return a column of the long steps as curves."""
    return [
        Curve(f"{kind}/lasting/{column}", long["t"], long[column], kind)
        for kind in SHOWN
        for long in [data.lasting(kind)]
    ]


def entry(data: Data) -> Entry:
    """Return the statements with a figure of the response to a step."""
    traces = {kind: data(kind, "step") for kind in SHOWN}
    figure = Figure(
        "response",
        "Response to a step",
        "Angle of the pendulum under PID, PID-RBF and IPID-RBF: left, the first 1.2 s after a step,"
        " in which it rises; right, 6 s with the band of ±5 %, in which it settles. Below, a step"
        " held for long: the force ramps until it reaches its limit, and the pendulum falls.",
        [
            [
                Panel("rising", ANGLE, outputs(traces), xlim=(0, 1.2), ylim=(0, 1.3)),
                Panel("settling", ANGLE, outputs(traces), xlim=(0, 6), ylim=(0.9, 1.1)),
            ],
            [
                Panel("held for long", FORCE, held(data, "u"), xlim=(0, 100), ylim=(-110, 110)),
                Panel("the end of it", ANGLE, held(data, "theta"), xlim=(88, 93), ylim=(-0.5, 3)),
            ],
        ],
    )
    return Entry(
        "abstract",
        "Abstract and introduction",
        "Not a figure of the paper: what its abstract and its list of innovations promise.",
        figure,
        claims(data),
    )
