"""Figure 2: step responses of the PID under different gains."""

from collections.abc import Sequence

import numpy as np

from ..claims import Claim, Finding, Row
from ..data import Data
from ..figure import ANGLE, Curve, Figure, Panel
from ..metrics import iae, overshoot, rise_time, settling
from ..scenarios import FACTORS, GAINS
from ..stability import RAMP
from .entry import Entry, numbered

STYLE = {0.5: "half", 1.0: "one", 2.0: "double"}
UNITS = {"kp": "N/rad", "ki": "N/(rad s)", "kd": "N s/rad"}
BAND = 0.02
"""Settling band for the speed of the response: a PID's static error exceeds the band of 0.3 %."""

DIFFERENT = 0.1
"""Relative difference above which responses count as different."""

ELIMINATED = 1e-6
"""Error below which it counts as eliminated [rad]."""

LABELS = {0.5: "½ {}", 1.0: "nominal", 2.0: "2 {}"}
"""Labels of multiplied gains in tables."""

CHANGED = [LABELS[factor].format(gain) for gain in GAINS for factor in FACTORS[::2]]


def figure(data: Data) -> Figure:
    """Return one panel per gain."""

    def panel(gain: str, zoom: bool) -> Panel:
        curves = []
        for factor in FACTORS:
            trace = data.gains(gain, factor)
            curves.append(Curve(f"{trace.key}/theta", trace.t, trace.theta, STYLE[factor]))
        if zoom:
            return Panel(f"{gain}, magnified", ANGLE, curves, xlim=(0, 20), ylim=(0.985, 1.015))
        title = f"{gain} around {GAINS[gain]:g} {UNITS[gain]}"
        return Panel(title, ANGLE, curves, xlim=(0, 5), ylim=(0, 1.6))

    return Figure(
        "figure-2",
        "Gains of the PID",
        "Angle of the pendulum after a step of 1 rad with a PID, with the proportional, the"
        " integral and the derivative gain each halved, as in the paper, and doubled.",
        [[panel(gain, False) for gain in GAINS], [panel(gain, True) for gain in GAINS]],
    )


def claims(data: Data) -> list[Claim]:
    """Return the claims of section 3.1 about the gains."""
    runs = {
        LABELS[factor].format(gain): data.gains(gain, factor)
        for gain in GAINS
        for factor in FACTORS
    }
    rise = {name: rise_time(trace) for name, trace in runs.items()}
    over = {name: overshoot(trace) for name, trace in runs.items()}
    settled = {name: settling(trace, band=BAND) for name, trace in runs.items()}
    static = {name: float(trace.e[-1]) for name, trace in runs.items()}
    area = {name: iae(trace) for name, trace in runs.items()}

    def cells(values: dict[str, float], columns: Sequence[str]) -> list[float]:
        return [values[column] for column in columns]

    def spread(values: dict[str, float], columns: Sequence[str]) -> bool:
        found = cells(values, columns)
        return max(found) > (1 + DIFFERENT) * min(found)

    def changes(columns: Sequence[str], quantities: dict[str, dict[str, float]]) -> Finding:
        """Each quantity spreads by more than 10 % over the settings."""
        return Finding(
            columns,
            [
                Row(name, cells(values, columns), spread(values, columns))
                for name, values in quantities.items()
            ],
        )

    def falls(columns: Sequence[str], quantities: dict[str, dict[str, float]]) -> list[Row]:
        """Each quantity falls from setting to setting."""
        return [
            Row(name, cells(values, columns), bool(np.all(np.diff(cells(values, columns)) < 0)))
            for name, values in quantities.items()
        ]

    def residual(_: str) -> Finding:
        columns = ["½ ki", "nominal", "2 ki"]
        closed = [-RAMP / (factor * GAINS["ki"] - RAMP) for factor in FACTORS]
        size = {column: abs(static[column]) for column in columns}
        return Finding(
            columns,
            [
                *falls(columns, {"|e(20 s)| [rad]": size}),
                Row(
                    "|e(20 s)| with 2 ki, below 1e-6 [rad]",
                    cells(size, columns),
                    size["2 ki"] < ELIMINATED,
                ),
                Row("e(20 s) [rad]", cells(static, columns)),
                Row("−b g / (ki − b g) [rad]", closed),
            ],
            "The plant has a zero at s = 0: to hold an angle the force must ramp, and a single"
            " integrator follows a ramp with a nonzero error.",
        )

    def rule(columns: Sequence[str], quantity: str, values: dict[str, float]) -> Finding:
        return Finding(
            ["nominal", "changed"],
            [
                Row(
                    f"{quantity}, {column}",
                    [values["nominal"], values[column]],
                    values[column] < values["nominal"],
                )
                for column in columns
            ],
        )

    def best(name: str, values: dict[str, float]) -> Row:
        setting = min(CHANGED, key=values.__getitem__)
        cells = [values["nominal"], values[setting], setting]
        return Row(name, cells, values["nominal"] <= values[setting])

    dynamic = ["½ kd", "nominal", "2 kd"]
    damping = {"overshoot [%]": over, "settling ±2 % [s]": settled}
    proportional = ["½ kp", "nominal", "2 kp"]
    fast = {"rise time [s]": rise, "settling ±2 % [s]": settled}
    return [
        Claim(
            "“different PID parameters have different response speeds and stability”",
            "rise time, settling time and overshoot each spread by more than 10 %",
            lambda _: changes(["nominal", *CHANGED], fast | {"overshoot [%]": over}),
        ),
        Claim(
            "“The proportional regulation coefficient kp can change the response speed of the"
            " system”",
            "rise time and settling time each change by more than 10 % from ½ kp to 2 kp",
            lambda _: changes(proportional, fast),
        ),
        Claim(
            "“and improve the regulation precision of the system”",
            "the integral of |e| and the last error fall as kp rises",
            lambda _: Finding(
                proportional,
                falls(
                    proportional,
                    {
                        "integral of |e| [rad s]": area,
                        "|e(20 s)| [rad]": {name: abs(value) for name, value in static.items()},
                    },
                ),
            ),
        ),
        Claim(
            "“The integral adjustment coefficient ki can eliminate the residual error.”",
            "|e(20 s)| falls as ki rises; with 2 ki it is below 1e-6 rad",
            residual,
        ),
        Claim(
            "“The dynamic performance of the system can be improved by differential adjustment"
            " coefficient kd.”",
            "read as more kd: overshoot and settling time fall as kd rises; as another kd: with"
            " half or double kd they are smaller than nominal",
            lambda _: Finding(
                dynamic,
                [
                    *falls(dynamic, {f"{name}, falling": v for name, v in damping.items()}),
                    *(
                        Row(
                            f"{name}, smaller than nominal",
                            cells(v, dynamic),
                            min(v["½ kd"], v["2 kd"]) < v["nominal"],
                        )
                        for name, v in damping.items()
                    ),
                ],
            ),
        ),
        Claim(
            "“the best parameters are selected to achieve the best control effect of the inverted"
            " pendulum system”",
            "none of the six other settings has a smaller value, in each row",
            lambda _: Finding(
                ["nominal", "best of six", "by"],
                [
                    best("rise time [s]", rise),
                    best("settling ±2 % [s]", settled),
                    best("overshoot [%]", over),
                    best("integral of |e| [rad s]", area),
                ],
            ),
        ),
        Claim(
            "“When the response curve oscillates significantly, kp should be increased, ki should"
            " be increased, and k_d should be smaller.”",
            "the overshoot is less than nominal after each of the three changes",
            lambda _: rule(["2 kp", "2 ki", "½ kd"], "overshoot [%]", over),
        ),
        Claim(
            "“When the error of the response curve is large, kp should be reduced, ki should be"
            " reduced, and k_d should be increased appropriately.”",
            "the integral of |e| is less than nominal after each of the three changes",
            lambda _: rule(["½ kp", "½ ki", "2 kd"], "integral of |e| [rad s]", area),
        ),
    ]


def entry(data: Data) -> Entry:
    """Return the figure with the paper's statements about it."""
    return numbered(
        2,
        "Step response curves under different PID parameters.",
        figure(data),
        claims(data),
        (
            "The paper gives the parameters only in the picture, not in the text. Here each gain is"
            " halved and doubled around the paper’s choice, everything else as in Figure 6.",
        ),
    )
