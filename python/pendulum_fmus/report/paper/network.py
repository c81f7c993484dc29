"""Sections 3.1 and 3.2: the network, its learning, and the proof of stability."""

from dataclasses import replace

import numpy as np

from ..claims import Claim, Finding, Row
from ..data import Data, Trace
from ..figure import Curve, Figure, Panel
from ..metrics import drift, falling_share
from ..numbers import number
from ..scenarios import KINDS, WEIGHTS
from ..stability import (
    LAWS,
    activation,
    held_plant,
    matrix,
    nodes,
    printed_bound,
    rate_limit,
    spectral_radius,
)
from .compare import COLUMNS, NETWORKS, by_signal, row
from .curves import END, SMALLEST, absolute_errors
from .entry import Entry
from .measures import LATE, OVERSHOOT, late_rms

ZERO = 1e-6
"""An error below this has vanished [rad]."""

LITTLE = 0.01
"""An output that changes by less than this stands still [N/s]."""

ALIKE = 0.1
"""Relative difference below which two derivatives are approximately equal."""


def linear(_: str) -> Finding:
    """Double the weights, and double the input."""
    by_input = float(nodes(2.0).sum() / nodes(1.0).sum())
    return Finding(
        ["u_n, relative"],
        [
            Row("all weights doubled [1]", [2.0], True),
            Row("input doubled, from 1 rad to 2 rad [1]", [by_input], abs(by_input - 2) < ALIKE),
        ],
        "The output is linear in the weights and in the outputs of the nodes, not in the input.",
    )


def minima(_: str) -> Finding:
    """Return the curvature of the performance indicator for a fixed force."""
    smallest = round(float(np.linalg.eigvalsh(np.outer(nodes(), nodes())).min()), 12) + 0.0
    return Finding(
        ["r = 1 rad"],
        [Row("smallest eigenvalue of ∂²E/∂w² = h hᵀ [1]", [smallest], smallest >= 0)],
        "For a fixed force E is quadratic along h and constant across it. In the closed loop the"
        " force changes with the weights; see section 3.2.",
    )


def derivatives(data: Data) -> Claim:
    """Return the approximation (17), from two runs whose initial weights differ."""

    def finding(_: str) -> Finding:
        base, moved = (data.loop(loop) for loop in WEIGHTS)
        rows = []
        for k, name in enumerate(("the same sample", "one sample later", "two samples later")):
            network = moved.u_n[0] - base.u_n[0]
            share = float((moved.u_p[k] - base.u_p[k]) / network)
            rows.append(
                Row(f"∂u_p/∂w, {name}, relative to ∂u_n/∂w [1]", [share], abs(share - 1) < ALIKE)
            )
        return Finding(
            ["PID-RBF"],
            rows,
            "A weight affects u_p only through the plant: not in the same sample, and"
            " then with the other sign.",
        )

    return Claim(
        "Section 3.1, (17): “∂u_p(k)/∂w_i(k) ≈ ∂u_n(k)/∂w_i(k)”",
        "two runs of which one starts with w_3 = 1 N: u_p differs by as much as u_n, within 10 %,"
        " at the same sample or one of the next two",
        finding,
    )


def energy_of(trace: Trace) -> np.ndarray:
    """Return V₁ of section 3.2 [rad²], shape (steps,)."""
    return np.cumsum(trace.e**2) / 2


def lyapunov(data: Data) -> Claim:
    """Return the statement that the Lyapunov function falls."""

    def falling(trace: Trace) -> float:
        return float(np.mean(np.diff(energy_of(trace)) < 0))

    name = "samples at which V falls"
    rows = by_signal(data, name, "1", falling, lambda v: v["PID-RBF"] == 1, KINDS[1:])
    return Claim(
        "Section 3.2: with V₁(k) = ½ Σ e²(i), i = 0 … k, “we can conclude ΔV₁[x(k)] < 0”",
        "V falls at every sample, with each signal",
        lambda _: Finding(
            COLUMNS,
            rows,
            "V, a sum of squares, can never fall: V(k + 1) − V(k) is e²(k + 1)/2. (35) shifts"
            " the index of one sum, and arrives at e²(k + 1)/2 − e²(0)/2.",
        ),
    )


def performance(data: Data) -> Claim:
    """Return the equation of the two performance indicators."""

    def finding(_: str) -> Finding:
        trace = data("PID-RBF", "step")
        rows = []
        for time in (0.01, 0.5, 5.0):
            k = int(np.searchsorted(trace.t, time - 1e-9))
            share = float((trace.u_n[k] - trace.u[k]) ** 2 / trace.e[k] ** 2)
            rows.append(Row(f"E/(½ e²) at {time:g} s [N²/rad²]", [share], abs(share - 1) < ALIKE))
        return Finding(
            ["PID-RBF, step"], rows, "E is a force squared, ½ u_p² while the force is not limited."
        )

    return Claim(
        "Section 3.2: “E(k) = (1/2)(u_n(k) − u(k))² = (1/2) e₁²(k)”",
        "the two agree within 10 % at 0.01 s, 0.5 s and 5 s of a step",
        finding,
    )


def bound(_: str) -> Finding:
    """Compare the printed bound with the eigenvalues of the loop."""
    printed = printed_bound()
    rows = []
    for share in (0.15, 0.25, 0.5, 0.99):
        law = replace(LAWS["PID-RBF"], eta=share * printed)
        radius = spectral_radius(matrix(law))
        rows.append(Row(f"spectral radius at η = {share * printed:.3g} [1]", [radius], radius < 1))
    rows.append(Row("largest stable η [1]", [rate_limit(LAWS["PID-RBF"], 0)]))
    return Finding(
        ["PID-RBF"],
        rows,
        f"With G = h, 2/|h|² is {printed:.3f} at r = 1, where |h|² is {activation():.4f}. The bound"
        " is that of the least-mean-squares rule, whose target stays where it is; here it is the"
        " controller’s own force. With the paper’s own G₁ = ∂e₁/∂w, after one sample, the bound is"
        f" {number(printed / float(held_plant()[1][1]) ** 2, 2)}, and excludes nothing.",
    )


def shrinking(data: Data) -> Claim:
    """Return the statement that |e| falls from sample to sample."""
    name = "samples at which |e| falls"
    over = OVERSHOOT[0].values(data)
    rows = [
        *by_signal(data, name, "1", lambda t: falling_share(t.e), lambda v: v["PID-RBF"] == 1),
        row(OVERSHOOT[0].name, over, over["PID-RBF"] == 0),
    ]
    return Claim(
        "Section 3.2, for PID-RBF: “|e₁(k + 1)| < |e₁(k)|”",
        "|e| of PID-RBF falls at every sample, with each signal; a step does not overshoot",
        lambda _: Finding(
            COLUMNS, rows, "A loop that overshoots cannot shrink its error throughout."
        ),
    )


def limit_zero(data: Data) -> Claim:
    """Return the statement that the error converges to zero."""
    name = "RMS of e from 19 s on"
    rows = by_signal(data, name, "rad", late_rms, lambda v: v["PID-RBF"] < ZERO)
    return Claim(
        "Section 3.2, for PID-RBF: “lim e₁(k) = 0” for k → ∞",
        "the RMS of its e from 19 s on is below 1e-6 rad, with each signal",
        lambda _: Finding(COLUMNS, rows),
    )


def convergent(data: Data) -> Claim:
    """Return the statement that the algorithm converges."""

    def finding(ipid: str) -> Finding:
        moved = {kind: drift(data(kind, "step").part(19.0, 21.0)) for kind in KINDS[1:]}
        error = LATE[0].values(data)
        return Finding(
            COLUMNS,
            [
                row(LATE[0].name, error, error["PID-RBF"] < ZERO),
                row("change of h · w from 19 s on, step [N/s]", moved, moved["PID-RBF"] < LITTLE),
            ],
            "The error converges, but the weights do not: they follow the force, which ramps.",
        )

    return Claim(
        "Section 3.2: “Therefore, the control algorithm is convergent.”",
        "after a step with PID-RBF the error is below 1e-6 rad from 19 s on, and the network’s"
        " output changes by less than 0.01 N/s",
        finding,
    )


def entries(data: Data) -> list[Entry]:
    """Return section 3.1, without Figure 2, and section 3.2."""
    traces = {kind: data(kind, "step") for kind in NETWORKS}
    sums_ = [Curve(f"V/{kind}", trace.t, energy_of(trace), kind) for kind, trace in traces.items()]
    figure = Figure(
        "lyapunov",
        "The proof of section 3.2",
        "Left, magnitude of the error of PID-RBF and IPID-RBF over 20 s of a step, on a logarithmic"
        " axis; right, the sum of its squares over the first 5 s, which never falls.",
        [
            [
                Panel(
                    "|e| does not fall from sample to sample",
                    "|e| [rad]",
                    absolute_errors(traces),
                    xlim=(0, END),
                    ylim=(SMALLEST, 10),
                    log_y=True,
                ),
                Panel("V₁ = ½ Σ e² never falls", "V₁ [rad²]", sums_, xlim=(0, 5)),
            ]
        ],
    )
    return [
        Entry(
            "network",
            "Section 3.1: the network",
            "",
            None,
            [
                Claim(
                    "“the mapping from input to output is linear”",
                    "the output doubles with the weights; it doubles with the input, within 10 %",
                    linear,
                ),
                Claim(
                    "“and avoids the problem of local minima”",
                    "for a fixed force the performance indicator (16) is convex in the weights",
                    minima,
                ),
                derivatives(data),
            ],
        ),
        Entry(
            "stability",
            "Section 3.2: the proof of stability",
            "Not a figure of the paper: the quantities of its proof.",
            figure,
            [
                performance(data),
                Claim(
                    "“When the value field of ηh_j is 0 < ηh_j < 2(G₁G₁ᵀ)⁻¹ […] the system is"
                    " stable.”",
                    "all modes of the sampled loop at r = 1 decay, at four rates below the bound"
                    " for G = h",
                    bound,
                ),
                lyapunov(data),
                shrinking(data),
                limit_zero(data),
                convergent(data),
            ],
        ),
    ]
