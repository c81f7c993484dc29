"""The conclusions of section 5 that are not about a single figure."""

from ..claims import Claim, Finding, judge
from ..data import Data
from ..metrics import overshoot, rms
from .compare import by_kind, least, table
from .tracking import worst_overshoot

ZERO = 1e-6
"""RMS below which an error has approached zero [rad]."""

SMALL = 0.005
"""Bound after 15 s on an error that approaches zero, relative to the amplitude [rad]."""


def claims(data: Data) -> list[Claim]:
    """Return the claims of section 5 about all figures without disturbance."""
    late = {
        signal: by_kind(data, signal, 0.0, lambda trace: rms(trace.part(19.0, 20.0).e))
        for signal in ("step", "sine", "square")
    }
    over = {
        "step [%]": by_kind(data, "step", 0.0, overshoot),
        "square wave, of the jump [%]": by_kind(data, "square", 0.0, worst_overshoot),
    }

    def zero(ipid: str) -> Finding:
        ends = [values[kind] for values in late.values() for kind in ("PID-RBF", ipid)]
        rows = {f"RMS of e from 19 s to 20 s, {signal} [rad]": late[signal] for signal in late}
        return Finding(judge(max(ends) < SMALL, max(ends) < ZERO), table(rows))

    return [
        Claim(
            "“the error of the input and output is continuously adjusted, so that the system error"
            " eventually approaches zero”",
            "from 19 s to 20 s the RMS of e of PID-RBF and IPID-RBF is below 0.005 rad for all"
            " three signals; fully if below 1e-6 rad",
            zero,
        ),
        Claim(
            "“Compared with the PID-RBF supervision control, the IPID-RBF control has smaller curve"
            " oscillation amplitude during the adjustment process”",
            "IPID-RBF overshoots less than PID-RBF after a step and after each jump of the wave",
            lambda ipid: Finding(
                judge(all(least(v, ipid, ["PID-RBF"]) for v in over.values())),
                table({f"overshoot, {name}": v for name, v in over.items()}),
            ),
        ),
    ]
