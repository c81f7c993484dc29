"""The conclusions of section 5."""

import math

from ..claims import Claim, Finding, Row
from ..data import Data
from ..metrics import drift
from ..scenarios import KINDS, SIGNALS
from ..stability import CENTRES
from .compare import (
    COLUMNS,
    IPID,
    NETWORKS,
    OTHERS,
    PID,
    RBF,
    better,
    limited,
    measured,
    row,
    split,
    variants,
)
from .entry import Entry
from .introduction import LASTING, TRACKED
from .measures import (
    ADJUSTMENT,
    AFTER_START,
    EFFORT,
    GROWTH,
    INTERFERENCE,
    LATE,
    OVERSHOOT,
    ROBUSTNESS,
    SPEED,
    accuracy,
    late_rms,
)

ZERO = 1e-6
"""RMS below which an error has approached zero [rad]."""

SMALL = 0.005
"""RMS below which an error is small, though not zero [rad]."""


def identified(data: Data) -> Claim:
    """Return the statement that learning identifies the plant."""

    def finding(ipid: str) -> Finding:
        kinds, errors = variants(NETWORKS, ipid), LATE[0].values(data)
        slope = {kind: drift(data(kind, "step").part(15.0, 21.0)) for kind in KINDS[1:]}
        return Finding(
            COLUMNS,
            [
                row(
                    "change of u_n at r = 1 from 15 s on, step [N/s]",
                    slope,
                    all(slope[kind] < 0.01 for kind in kinds),
                ),
                row(LATE[0].name, errors, all(errors[kind] < TRACKED for kind in kinds)),
            ],
            "Nothing of the plant is identified: the network learns the controller’s own force, and"
            " has to go on learning while the set-point stands still.",
        )

    return Claim(
        "IPID-RBF “controls the controlled object through online learning to achieve online"
        " identification and control”",
        "what has been identified stays: at a constant set-point the network’s output changes by"
        " less than 0.01 N/s from 15 s on; what is controlled follows: |e| is"
        " below 0.05 rad from 19 s on",
        finding,
    )


def simple(_: Data) -> Claim:
    """Return the statement that the algorithm is simple."""
    network = 2 * len(CENTRES) + 2  # centres and widths, learning rate and momentum
    return Claim(
        "“This algorithm has simple control”",
        "IPID-RBF needs no more parameters, controllers and models of the plant than PID",
        lambda ipid: Finding(
            COLUMNS,
            [
                Row("parameters to choose", [3, 3 + network, 3 + network, 3 + network], False),
                Row("controllers that run", [1, 1, 2, 1], ipid != "IPID-RBF"),
                Row("models of the plant beside it", [0, 0, 1, 0], ipid != "IPID-RBF"),
            ],
            "As in Table 1, IPID-RBF needs a PID-RBF loop beside it, with a plant of its own.",
        ),
    )


def zero(data: Data) -> Claim:
    """Return the statement that the error approaches zero."""
    return limited(
        data,
        "“Under three different input signals, […] the error of the input and output is"
        " continuously adjusted, so that the system error eventually approaches zero.”",
        NETWORKS,
        [
            (measured("RMS of e from 19 s on", "rad", late_rms, signal), bound)
            for signal in SIGNALS
            for bound in (SMALL, ZERO)
        ],
    )


def stability(data: Data) -> Claim:
    """Return the statement that the stability is good."""

    def finding(ipid: str) -> Finding:
        kinds = variants(NETWORKS, ipid)
        growth, lost = GROWTH.values(data), LASTING.values(data)
        return Finding(
            COLUMNS,
            [
                *split(GROWTH.name, growth, {kind: growth[kind] < 0 for kind in kinds}),
                *split(LASTING.name, lost, {kind: math.isinf(lost[kind]) for kind in kinds}),
            ],
        )

    return Claim(
        "“and the stability of the system is good”",
        "PID-RBF and IPID-RBF: all modes of the sampled loop decay; a step is held for 110 s",
        finding,
    )


def entry(data: Data) -> Entry:
    """Return the statements of section 5."""
    overall = [ADJUSTMENT[2], OVERSHOOT[0], *accuracy()]
    claims = [
        better(
            data,
            "“the IPID-RBF control applied to the model has better performance”",
            [SPEED[0], *overall],
            IPID,
            OTHERS,
        ),
        limited(
            data,
            "“the input signal tracking is well achieved”",
            IPID,
            [(measure, TRACKED) for measure in LATE],
        ),
        zero(data),
        better(
            data,
            "“Compared with the traditional PID control, the IPID-RBF control has the best tracking"
            " effect with the input signal under three different input signals.”",
            accuracy(),
            IPID,
            OTHERS,
        ),
        better(
            data,
            "“It has improved the characteristics of traditional PID with low accuracy.”",
            [m for m in accuracy() if m.name.startswith(("integral of |e|", "|e(20 s)|"))],
            IPID,
            PID,
        ),
        better(
            data,
            "“Compared with the PID-RBF supervision control, the IPID-RBF control has smaller curve"
            " oscillation amplitude during the adjustment process”",
            [OVERSHOOT[0], OVERSHOOT[1], *EFFORT[:3]],
            IPID,
            RBF,
        ),
        better(
            data,
            "“and the system reaches a stable state in a short time”, compared with PID-RBF",
            ADJUSTMENT,
            IPID,
            RBF,
        ),
        better(
            data,
            "“and has strong anti-interference ability”, compared with PID-RBF",
            INTERFERENCE,
            IPID,
            RBF,
        ),
        simple(data),
        limited(
            data,
            "“and good tracking accuracy”",
            IPID,
            [(measure, 0.01) for measure in (AFTER_START, LATE[0], LATE[2])],
        ),
        better(
            data,
            "“Therefore, the improved control algorithms have good robustness”",
            ROBUSTNESS,
            NETWORKS,
            PID,
            "“Good” is read as better than the PID that they improve.",
        ),
        stability(data),
        identified(data),
        better(data, "“It has high control accuracy”", accuracy(), IPID, OTHERS),
        better(
            data,
            "“good dynamic characteristics”",
            [SPEED[0], *ADJUSTMENT[:3], OVERSHOOT[0]],
            IPID,
            OTHERS,
        ),
        better(data, "“and anti-interference ability”", INTERFERENCE, IPID, OTHERS),
    ]
    return Entry("conclusions", "Section 5: conclusions", "", None, claims)
