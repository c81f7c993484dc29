"""Figure 2: step responses of the PID under different gains."""

from ..claims import Claim, Finding, Table, Verdict, judge
from ..data import Data
from ..figure import ANGLE, Curve, Figure, Panel
from ..metrics import iae, overshoot, rise_time, settling
from ..scenarios import FACTORS, GAINS
from .entry import Entry

STYLE = {0.5: "half", 1.0: "one", 2.0: "double"}
UNITS = {"kp": "N/rad", "ki": "N/(rad s)", "kd": "N s/rad"}
BAND = 0.02
"""Settling band for the speed of the response: a PID's static error exceeds the band of 0.3 %."""

DIFFERENT = 0.1
"""Relative difference above which responses count as different."""

ELIMINATED = 1e-6
"""Error below which it counts as eliminated [rad]."""

RAMP = 0.1 * 9.8
"""b g: the rate at which the force that holds 1 rad falls, since the cart accelerates by -g theta
and its friction b grows with its speed [N/s]."""

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

    def table(quantities: dict[str, dict[str, float]], columns: list[str]) -> Table:
        rows = {name: [values[c] for c in columns] for name, values in quantities.items()}
        return Table(columns, rows)

    def spread(values: dict[str, float]) -> bool:
        return max(values.values()) > (1 + DIFFERENT) * min(values.values())

    def differ(_: str) -> Finding:
        return Finding(
            judge(spread(settled) and spread(over)),
            table(
                {"rise time [s]": rise, "settling ±2 % [s]": settled, "overshoot [%]": over},
                ["nominal", *CHANGED],
            ),
        )

    def speed(_: str) -> Finding:
        columns = ["½ kp", "nominal", "2 kp"]
        values = {c: settled[c] for c in columns}
        return Finding(
            judge(spread({c: rise[c] for c in columns}) or spread(values)),
            table({"rise time [s]": rise, "settling ±2 % [s]": settled}, columns),
        )

    def residual(_: str) -> Finding:
        columns = ["½ ki", "nominal", "2 ki"]
        low, middle, high = (abs(static[c]) for c in columns)
        closed = {
            column: -RAMP / (factor * GAINS["ki"] - RAMP)
            for column, factor in zip(columns, FACTORS, strict=True)
        }
        return Finding(
            judge(low > middle > high, high < ELIMINATED),
            table({"e(20 s) [rad]": static, "−b g / (ki − b g) [rad]": closed}, columns),
            "The plant has a zero at s = 0: to hold an angle the force must ramp, and a single"
            " integrator follows a ramp with a nonzero error.",
        )

    def damping(_: str) -> Finding:
        columns = ["½ kd", "nominal", "2 kd"]
        low, middle, high = (over[c] for c in columns)
        first, _, last = (settled[c] for c in columns)
        return Finding(
            judge(low > middle > high, last < first),
            table({"overshoot [%]": over, "settling ±2 % [s]": settled}, columns),
            f"With more kd the overshoot {_trend(low, high)}, the settling time"
            f" {_trend(first, last)}.",
        )

    def rule(columns: list[str], quantity: str, values: dict[str, float]) -> Finding:
        better = [values[c] < values["nominal"] for c in columns]
        verdict = Verdict.HOLDS if all(better) else Verdict.REMARK if any(better) else Verdict.FAILS
        helps = ", ".join(c for c, good in zip(columns, better, strict=True) if good) or "nothing"
        remark = "" if all(better) else f"It is lowered here by {helps}."
        return Finding(verdict, table({quantity: values}, ["nominal", *columns]), remark)

    return [
        Claim(
            "“different PID parameters have different response speeds and stability”",
            "settling time and overshoot each spread by more than 10 % over the settings",
            differ,
        ),
        Claim(
            "“The proportional regulation coefficient kp can change the response speed”",
            "rise or settling time changes by more than 10 % from ½ kp to 2 kp",
            speed,
        ),
        Claim(
            "“The integral adjustment coefficient ki can eliminate the residual error.”",
            "|e(20 s)| falls as ki rises; fully if it ends below 1e-6 rad",
            residual,
        ),
        Claim(
            "“The dynamic performance of the system can be improved by” kd",
            "read as more kd: the overshoot falls as kd rises; fully if the settling time does too",
            damping,
        ),
        Claim(
            "“When the response curve oscillates significantly, kp should be increased, ki should"
            " be increased, and k d should be smaller.”",
            "the overshoot falls by each of the three; with a remark if by some of them",
            lambda _: rule(["2 kp", "2 ki", "½ kd"], "overshoot [%]", over),
        ),
        Claim(
            "“When the error of the response curve is large, kp should be reduced, ki should"
            " reduced, and k d should be increased”",
            "the integral of |e| falls by each of the three; with a remark if by some of them",
            lambda _: rule(["½ kp", "½ ki", "2 kd"], "IAE [rad s]", area),
        ),
    ]


def _trend(first: float, last: float) -> str:
    return "rises" if last > first else "falls"


def entry(data: Data) -> Entry:
    """Return the figure with the paper's claims about it."""
    return Entry(
        2,
        "Step response curves under different PID parameters.",
        figure(data),
        claims(data),
        (
            "The paper gives the parameters only in the picture, not in the text. Here each gain is"
            " halved and doubled around the paper’s choice, everything else as in Figure 6.",
        ),
    )
