"""Figures 16 to 21: the errors of the three controllers."""

from collections.abc import Sequence

from ..claims import Claim
from ..data import Data
from ..figure import Figure
from .compare import IPID, NETWORKS, OTHERS, PID, Measure, better
from .curves import Span, error_rows
from .entry import Entry, numbered
from .measures import accuracy, adjustment, returns


def times(signal: str, amplitude: float) -> Sequence[Measure]:
    """Return the adjustment times: after the pulse if there is one."""
    return returns([(signal, amplitude)]) if amplitude else adjustment([signal])


def claims(data: Data, signal: str, amplitudes: Sequence[float]) -> list[Claim]:
    """Return the statements of section 4 about the error figures of one signal."""
    errors = [measure for a in amplitudes for measure in accuracy([signal], a)]
    settling = [measure for a in amplitudes for measure in times(signal, a)]
    return [
        better(
            data,
            "“the traditional PID control has the worst effect […] and greater error than the other"
            " two control algorithms”",
            errors,
            NETWORKS,
            PID,
        ),
        better(data, "PID has a “long adjustment time”", settling, NETWORKS, PID),
        better(
            data,
            "“The IPID-RBF control can reach a stable state in a short time no matter whether there"
            " is no interference or interference.”",
            settling,
            IPID,
            OTHERS,
        ),
    ]


def _entry(
    data: Data,
    number: int,
    caption: str,
    signal: str,
    amplitudes: tuple[float, ...],
    zoom: tuple[Span, Span],
) -> Entry:
    disturbed = bool(amplitudes[0])
    pulse = ", the measured angle disturbed from 5 s to 5.5 s" if disturbed else ""
    figure = Figure(
        f"figure-{number}",
        f"{signal.capitalize()}{' with disturbance' if disturbed else ''}: errors",
        f"Error of PID, PID-RBF and IPID-RBF over 20 s, for a {signal}{pulse}; with a magnified"
        " part, and the absolute values on a logarithmic axis.",
        [row for a in amplitudes for row in error_rows(data, signal, a, *zoom)],
    )
    notes = ["The logarithmic panel was added, as the final errors of Table 1 span ten decades."]
    if len(amplitudes) > 1:
        notes.append(
            "The paper does not state the amplitude of the disturbance here: both are shown."
        )
    return numbered(number, caption, figure, claims(data, signal, amplitudes), notes)


def entries(data: Data) -> list[Entry]:
    """Return the figures with the paper's statements about them."""
    quiet = (0.0,)
    return [
        _entry(
            data, 16, "Step signal tracking error without interference.",
            "step", quiet, ((0, 6), (-0.05, 0.05)),
        ),
        _entry(
            data, 17, "Step signal tracking error under interference.",
            "step", (1.0,), ((4.8, 8), (-1.2, 1.2)),
        ),
        _entry(
            data, 18, "Sinusoidal signal tracking error without interference.",
            "sine", quiet, ((0, 2), (-0.03, 0.03)),
        ),
        _entry(
            data, 19, "Sinusoidal signal tracking error under interference.",
            "sine", (1.0, 2.0), ((4.8, 8), (-2.2, 2.2)),
        ),
        _entry(
            data, 20, "Wave signal tracking error without interference.",
            "square", quiet, ((4.8, 10), (-0.1, 0.1)),
        ),
        _entry(
            data, 21, "Tracking error of wave signal under interference.",
            "square", (1.0, 2.0), ((4.8, 8), (-3.2, 2.2)),
        ),
    ]  # fmt: skip
