"""Styles of curves, which differ in colour, dashes, width and marker for greyscale prints."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    """The style of one kind of curve.

    Parameters
    ----------
    name
        Name in the legend.
    light, dark
        Colours on white and on black, safe for the colour-blind.
    dash
        Lengths of dashes and gaps [pt]; empty for a solid line.
    width
        Line width [pt].
    marker
        Matplotlib marker; "" for none.
    """

    name: str
    light: str
    dark: str
    dash: tuple[float, ...]
    width: float
    marker: str = ""


STYLES = {
    "r": Style("reference r", "#a0a0a0", "#7d7d7d", (), 3.4),
    "PID": Style("PID", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "PID-RBF": Style("PID-RBF", "#0072b2", "#56b4e9", (1.6, 1.4), 1.6, "o"),
    "IPID-RBF": Style("IPID-RBF", "#7a0f3c", "#f29bc0", (), 1.3, "^"),
    "IPID-RBF own": Style("IPID-RBF, own target", "#00805a", "#3fd3a4", (7, 2, 1.5, 2), 1.5, "D"),
    "u": Style("u", "#202020", "#e8e8e8", (), 1.2),
    "u_n": Style("u_n", "#0072b2", "#56b4e9", (5, 2), 1.5, "o"),
    "u_p": Style("u_p", "#d07a00", "#f0a030", (1.6, 1.4), 1.5, "s"),
    "half": Style("half", "#0072b2", "#56b4e9", (1.6, 1.4), 1.6, "o"),
    "one": Style("as in the paper", "#202020", "#e8e8e8", (), 1.3),
    "double": Style("double", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "winding": Style("without anti-windup", "#d07a00", "#f0a030", (6, 2), 1.5, "s"),
    "held": Style("with anti-windup", "#0072b2", "#56b4e9", (), 1.4, "o"),
    "limit": Style("limit", "#a0a0a0", "#7d7d7d", (), 1.4),
}
