"""Integrator windup at the force limit, and the effect of anti-windup."""

from pathlib import Path

import numpy as np

from ...loop import Loop
from ..claims import Claim, Finding, Row
from ..data import Data, Trace
from ..figure import ANGLE, FORCE, Curve, Figure, Panel
from ..metrics import iae, largest, overshoot
from ..paper.curves import curve, outputs
from ..parts import Part
from .section import section, statement

CONTROLLERS = {"PID": "Pid", "PID-RBF": "PidRbf", "IPID-RBF, own": "IpidRbf"}
SUMMING = ("PID", "PID-RBF")
"""The controllers whose integral does not leak."""

LIMITS = (25.0, 35.0, 50.0, 70.0, 100.0, 140.0, 200.0)
"""Force limits [N]."""

LOW, PRINTED = LIMITS[0], 100.0
"""The lowest limit, and that of Table 1 [N]."""

STEPS = 4000

DISTURBED = (("step", 0.0), ("step", 1.0), ("square", 0.0), ("square", 1.0))
"""Signals and disturbances [rad] of Table 1 in which the force reaches its limit."""

DISTURBED_STEPS = 8000

LITTLE = 0.05
"""Relative change of the integral of |e| that counts as little."""

BRIEF = 0.2
"""A force that is limited for less time in a run counts as rarely limited [s]."""

SAME = 1e-6
"""Angles that differ by less are visually the same [rad]."""

STYLES = {False: "winding", True: "held"}

Overshoots = dict[tuple[str, bool], list[float]]
"""Overshoots of a controller without or with anti-windup, for each of LIMITS [%]."""


def loop(kind: str, limit: float, anti_windup: bool) -> Loop:
    """Return the step response of a controller with a force limit [N]."""
    overrides = (("controller.u_max", limit), ("controller.anti_windup", anti_windup))
    return Loop(CONTROLLERS[kind], "step", 0.0, overrides=overrides, steps=STEPS)


def disturbed(kind: str, signal: str, amplitude: float, anti_windup: bool) -> Loop:
    """Return a loop of Table 1."""
    overrides = (("controller.anti_windup", anti_windup),)
    return Loop(CONTROLLERS[kind], signal, amplitude, overrides=overrides, steps=DISTURBED_STEPS)


def loops() -> list[Loop]:
    """Return all loops of the section."""
    steps = [loop(k, limit, on) for k in CONTROLLERS for limit in LIMITS for on in STYLES]
    return steps + [disturbed(k, *case, on) for k in SUMMING for case in DISTURBED for on in STYLES]


def part(data: Data, fmus: Path) -> Part:
    """Return the section."""
    steps = {
        (kind, on): [data.loop(loop(kind, limit, on)) for limit in LIMITS]
        for kind in CONTROLLERS
        for on in STYLES
    }
    above = {(k, on): [overshoot(t) for t in steps[k, on]] for k in SUMMING for on in STYLES}
    return section(
        "beyond-windup",
        "Windup",
        figure({style: steps["PID", on][0] for on, style in STYLES.items()}, above),
        [winding(above), printed(data), nothing_to_wind(steps)],
        (
            "The parameter anti_windup, off by default, omits a sample from the sum of the error"
            " if its force is limited and the error would drive the force further beyond the"
            " limit. The paper has no anti-windup.",
        ),
    )


def winding(above: Overshoots) -> Claim:
    """Return the statement about the overshoot over the limit."""
    columns = [f"{kind}, {'with' if on else 'without'}" for kind, on in above]
    rows = [
        Row(
            f"overshoot at {limit:g} N [%]",
            [values[i] for values in above.values()],
            all(above[kind, True][i] < above[kind, False][i] for kind in SUMMING),
        )
        for i, limit in enumerate(LIMITS)
    ]
    rises = [bool((np.diff(values) < 0).all()) for values in above.values()]
    rows += [
        Row(
            "overshoot rises as the limit falls",
            ["yes" if one else "no" for one in rises],
            all(one for (_, on), one in zip(above, rises, strict=True) if not on),
        )
    ]
    return statement(
        "The lower the force limit, the more PID and PID-RBF overshoot due to integrator windup;"
        " with anti-windup they overshoot less",
        f"step, limits from {LOW:g} N to {LIMITS[-1]:g} N; the overshoot is smaller with"
        " anti-windup, for both controllers, at each limit; without, it rises as the limit falls",
        Finding(columns, rows),
    )


def printed(data: Data) -> Claim:
    """Return the statement about the loops of Table 1."""
    rows = []
    for case in DISTURBED:
        for kind in SUMMING:
            free, held = (data.loop(disturbed(kind, *case, on)) for on in STYLES)
            limited = float(np.sum(np.abs(free.u) == PRINTED) * free.ts)
            signal, amplitude = case
            before, after = iae(free), iae(held)
            little = abs(after / before - 1) < LITTLE and limited < BRIEF
            name = f"{kind}, {signal}, disturbance {amplitude:g} rad"
            rows.append(Row(name, [before, after, limited], little))
    return statement(
        "At the limit of Table 1 anti-windup gains little, as the force is limited only for some"
        " hundredths of a second",
        f"step and square wave, with and without a disturbance of 1 rad, {PRINTED:g} N, 8 s; the"
        f" integral of |e| changes by less than 5 %, and the force is limited for less than"
        f" {BRIEF:g} s, in each row",
        Finding(["∫|e| dt without [rad s]", "∫|e| dt with [rad s]", "limited, without [s]"], rows),
    )


def nothing_to_wind(steps: dict[tuple[str, bool], list[Trace]]) -> Claim:
    """Return the statement about IPID-RBF."""
    apart = {
        kind: max(
            largest(held.theta - free.theta)
            for free, held in zip(steps[kind, False], steps[kind, True], strict=True)
        )
        for kind in CONTROLLERS
    }
    own = apart["IPID-RBF, own"]
    return statement(
        "IPID-RBF does not wind up: its integral leaks, and its network learns the force as it was"
        " limited",
        "the same steps; the angle with and without anti-windup differs by less than 1e-6 rad at"
        " every limit",
        Finding(list(apart), [Row("max |Δθ| [rad]", list(apart.values()), own < SAME)]),
    )


def figure(low: dict[str, Trace], above: Overshoots) -> Figure:
    """Return the figure of the PID's steps at the lowest limit and of the overshoots."""
    forces = [curve(trace, "u", style) for style, trace in low.items()]
    shown = (0.0, 2.0)
    over = [
        Panel(
            f"{kind}: overshoot",
            "overshoot [%]",
            [
                Curve(f"windup/{kind}/{on}", np.array(LIMITS), np.array(above[kind, on]), style)
                for on, style in STYLES.items()
            ],
            x_label="force limit [N]",
        )
        for kind in SUMMING
    ]
    return Figure(
        "windup",
        "Windup",
        f"Top, angle and force of a PID limited to {LOW:g} N after a step, with and without"
        " anti-windup; bottom, overshoot of PID and PID-RBF over the force limit.",
        [
            [
                Panel(f"PID, at most {LOW:g} N", ANGLE, outputs(low), xlim=shown),
                Panel("its force", FORCE, forces, xlim=shown),
            ],
            over,
        ],
    )
