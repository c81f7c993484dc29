"""The statements of `statements.toml`: their rows, and the parts of the page that show them."""

import itertools
import math
import operator
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..loop import TS
from ..table1 import TRANSIENT_TOLERANCE
from . import beyond, design, figure, findings
from .claims import COLUMNS, Claim, Part, Row, Shown, Statement, Verdict, counts
from .figure import Figure
from .measures import MEASURES, SIGNAL_NAMES, LoopMeasure, Measure, after, finite, largest, tone
from .runs import KINDS, SIGNALS, Data, Trace
from .stability import LAWS, RAMP, activation, growth, limit, printed_bound

SPREAD = 1.1
"""Ratio of the largest to the smallest value above which responses count as different."""

COMPARISONS = {"<": operator.lt, "below": operator.lt, ">": operator.gt, "=": operator.eq}

VERBS = {"beat", "settle", "spread", "fall", *COMPARISONS}


RANKS = dict.fromkeys(Verdict, 2) | {Verdict.FAILS: 0, Verdict.PART: 1}
"""An order of the verdicts."""


@cache
def texts() -> dict[str, Any]:
    """Return the contents of the file."""
    return tomllib.loads((Path(__file__).parent / "statements.toml").read_text(encoding="utf-8"))


def expanded(words: str, cases: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the keys of measures with a case each; `cases` belong to measures without one."""
    for word in words.split():
        key, _, case = word.partition(".")
        own = [case] if case else cases
        if group := texts()["group"].get(key):
            specific = "." in group or isinstance(MEASURES.get(group.split()[0]), LoopMeasure)
            for each in [cases] if specific else [[one] for one in own]:
                yield from expanded(group, each)
        elif key not in MEASURES:
            raise KeyError(f"there is no measure {key!r}")
        else:
            of_loop = isinstance(MEASURES[key], LoopMeasure)
            yield from ((key, each) for each in ([""] if of_loop else own))


def case_of(text: str) -> tuple[str, float]:
    """Return the signal and the amplitude of the disturbance [rad] of a text such as "sine+2"."""
    signal, _, amplitude = text.partition("+")
    return signal, float(amplitude or 0)


@cache
def values_of(data: Data, key: str, case: str) -> Mapping[str, float]:
    """Measure all controllers that have a measure."""
    measure = MEASURES[key]
    if isinstance(measure, LoopMeasure):
        return {kind: measure.of(data, kind) for kind in KINDS}
    kinds = KINDS[1:] if measure.learns else KINDS
    return {kind: measure.value(data(kind, *case_of(case))) for kind in kinds}


def holds(measure: Measure, verb: str, values: Sequence[float], bound: Sequence) -> list[bool]:
    """Return by which values a rule holds; `bound` has the values that are to be beaten."""
    match verb:
        case "spread":
            return [max(values) > SPREAD * min(values)]
        case "fall":
            return [bool(np.all(np.diff(values) < 0))]
        case "settle":
            return [not math.isnan(value) for value in values]
        case "beat":
            better = operator.gt if measure.more else operator.lt
            return [all(better(finite(v), finite(other)) for other in bound) for v in values]
    return [COMPARISONS[verb](finite(value), float(bound[0])) for value in values]


class Table:
    """The columns of a finding: controllers, or the traces of loops.

    `ipid` is the variant of IPID-RBF that is judged. The `loops` of a statement, as in the file,
    have both networks as columns.
    """

    def __init__(self, data: Data, ipid: str, statement: Mapping[str, Any]):
        self.data, self.ipid = data, ipid
        self.traces: list[Trace] = []
        self.columns = list(statement.get("columns", COLUMNS))
        loops = statement.get("loops", [])
        if loops:
            self.columns = []
        for signal, amplitude in map(case_of, loops):
            for kind in ("PID-RBF", ipid):
                shown = f"{kind}, d = {amplitude:g} rad" if len(loops) > 1 else kind
                self.columns.append(shown)
                self.traces.append(data(kind, signal, amplitude))
        if set(self.columns) <= findings.SETTINGS.keys():
            self.traces = [data.gains(*findings.SETTINGS[column]) for column in self.columns]

    def rows(self, text: str) -> list[Row]:
        """Return the rows of measures, and what is asked of them."""
        words, _, rule = text.partition(":")
        asked = [word if word in KINDS else word.removesuffix("s") for word in rule.split()]
        at = next((i for i, word in enumerate(asked) if word in VERBS), len(asked))
        verb, bound = "".join(asked[at : at + 1]), asked[at + 1 :]
        if not self.traces:
            pairs = expanded(words, SIGNALS)
            return [row for pair in pairs for row in self._of(*pair, asked[:at], verb, bound)]
        rows = []
        for measure in map(MEASURES.__getitem__, words.split()):  # each column has to hold
            values = [measure.of(trace) for trace in self.traces]
            judged = all(holds(measure, verb, values, bound)) if verb else None
            rows.append(Row(measure.title(), values, judged))
        return rows

    def _of(
        self, key: str, case: str, judged: Sequence[str], verb: str, bound: Sequence[str]
    ) -> list[Row]:
        """Return a row, or one for each controller if it depends on it whether they hold."""
        values, measure = values_of(self.data, key, case), MEASURES[key]
        kinds, others = ([self.variant(k) for k in ks if k in KINDS] for ks in (judged, bound))
        shown = [
            values.get(k, "") for k, c in zip(KINDS, COLUMNS, strict=True) if c in self.columns
        ]
        name, unit = measure.title(*case_of(case)).removesuffix("]").rsplit(" [", 1)
        bound = [values[k] for k in others] or bound
        if verb == "below":
            name += f", below {float(bound[0]):g}".replace("e-0", "e-")
        found = [values[kind] for kind in kinds]
        if not verb or (verb == "beat" and len({*found, *bound}) == 1):
            return [Row(f"{name} [{unit}]", shown)]
        verdicts = dict(zip(kinds, holds(measure, verb, found, bound), strict=True))
        each = verb in ("beat", "below") or "each" in judged
        if not each or len(set(verdicts.values())) == 1:
            return [Row(f"{name} [{unit}]", shown, all(verdicts.values()))]
        return [
            Row(f"{name}, {kind.removesuffix(' own')} [{unit}]", shown, verdict)
            for kind, verdict in verdicts.items()
        ]

    def variant(self, kind: str) -> str:
        """Replace IPID-RBF by the variant that is judged."""
        return self.ipid if kind == "IPID-RBF" else kind


# --- the parts of the page ----------------------------------------------------------------------


def facts(data: Data) -> dict[str, Any]:
    """Return the numbers for the texts about the paper."""
    long = data.lasting("PID-RBF")
    at_limit = np.flatnonzero((np.abs(long.u) >= 100) & (long.t > 20))
    square, held = data("PID-RBF", "square"), after(data("PID"), 15)
    return {
        "ramp": RAMP,
        "pid_ramp": Shown(np.polyfit(held.t, held.u, 1)[0]),
        "saturated": float(long.t[at_limit[0]]),
        "lost": values_of(data, "lost", ""),
        "sine_error": findings.sine_error(1.0),
        "cosine_error": findings.cosine_error(1.0),
        "slow": 1 / growth(LAWS["IPID-RBF"]),
        "bound": printed_bound(),
        "activation": activation(),
        "ringing": tone(square.part((5.05, 5.35)).u, square.ts),
        "kick": largest(square.u_p),
    }


def paper_parts(data: Data) -> list[Part]:
    """Judge the statements of the paper; return its sections and figures."""
    known, found, count = facts(data), [], itertools.count(1)
    for part in texts()["part"]:
        kind = texts()["kind"].get(part.get("kind"), {})
        statements = [
            Statement(
                one["says"],
                [_claim(data, clause, known) for clause in one.get("clause", [one])],
                next(count),
            )
            for one in part.get("statement", ())
        ]
        drawn = _figure(data, part, kind)
        anchor, heading = part.get("anchor"), part.get("heading")
        if "figure" in part:
            anchor = f"figure-{part['figure']}"
            heading = f"Figure {part['figure']}. {drawn.title}"
        notes = [
            text.format_map(known) for text in (*kind.get("notes", ()), *part.get("notes", ()))
        ]
        found.append(Part(anchor, heading, part.get("caption", ""), notes, drawn, statements))
    return found


def headline(data: Data) -> Figure:
    """Return the figure of the curves that decide."""
    given = texts()["headline"]
    panels = figure.panels(given["panels"], figure.headline(data))
    return Figure("headline", given["title"], given["alt"], panels)


def summary(data: Data, parts: Sequence[Part], table: Sequence[Any]) -> list[tuple]:
    """Return the sentences of the first screen, each with its head; `table` has Table 1's lines."""

    def of(key: str, case: str = "") -> dict[str, Shown]:
        return {kind: Shown(value) for kind, value in values_of(data, key, case).items()}

    claims = [claim for part in parts for one in part.statements for claim in one.claims]
    ranks = [(RANKS[one.verdict], RANKS[one.own.verdict]) for one in claims]
    sine, printed = of("iae", "sine"), [line for line in table if not line.entry.fitted]
    apart = [line for line in printed if not line.digits]
    weights = [abs(line.apart) for line in apart if line.entry.label[2] == "sine"]
    (transient,) = (line.apart for line in apart if line.entry.tolerance == TRANSIENT_TOLERANCE)
    known = {verdict.css: count for verdict, count in counts(parts).items()} | {
        "numbers": len(printed),
        "digits": sum(line.digits for line in printed),
        "weights": len(weights),
        "weights_apart": Shown(100 * max(weights)),
        "transient_apart": Shown(100 * abs(transient)),
        "settings": len(texts()["setting"]),
        "corrections": len(texts()["correction"]),
        "sentences": sum(counts(parts).values()),
        "overshoot": of("overshoot", "step"),
        "sine": {kind: Shown(100 * (1 - value / sine["PID"])) for kind, value in sine.items()},
        "settling": of("settling_2", "step"),
        "rise": of("rise", "step"),
        "delay": {kind: Shown(1000 * TS * value) for kind, value in of("delay_margin").items()},
        "bound": Shown(printed_bound()),
        "limit": Shown(limit(LAWS["PID-RBF"])),
        "lost": of("lost"),
        "error": of("last", "step"),
        "better": sum(own > table1 for table1, own in ranks),
        "worse": sum(own < table1 for table1, own in ranks),
    }
    return [(one["head"], one["text"].format_map(known)) for one in texts()["summary"]]


def _figure(data: Data, part: Mapping[str, Any], kind: Mapping[str, str]) -> Figure | None:
    """Return the figure of a part of the paper."""
    if "title" in part:
        name = f"figure-{part['figure']}" if "figure" in part else part["name"]
        panels = figure.panels(part["panels"], getattr(figure, part["draw"])(data))
        return Figure(name, part["title"], part["alt"], panels)
    if not kind:
        return None
    signal, rows = part["signal"], figure.zoomed(data, part["kind"], part["signal"], part["zooms"])
    disturbed = any("d" in zoom for zoom in part["zooms"])
    shown = SIGNAL_NAMES[signal]
    pulse = ", the measured angle disturbed from 5 s to 5.5 s" * disturbed
    title = f"{shown.capitalize()}{' with disturbance' * disturbed}: {kind['title']}"
    return Figure(f"figure-{part['figure']}", title, kind["alt"].format(shown + pulse), rows)


def _claim(data: Data, clause: Mapping[str, Any], known: Mapping[str, Any]) -> Claim:
    """Measure a clause for both variants of IPID-RBF."""
    found = None
    for ipid in reversed(KINDS[2:]):
        table = Table(data, ipid, clause)
        rows = [row for text in clause.get("rows", ()) for row in table.rows(text)]
        if "finding" in clause:
            name, *arguments = clause["finding"].replace(":", "").split()
            rows += getattr(findings, name)(table, *arguments)
        words, criterion = clause.get("words", ""), clause.get("criterion") or _criterion(clause)
        remark = clause.get("remark", "").format_map(known)
        kind = {flag: clause[flag] for flag in ("fitted", "claimed") if flag in clause}
        found = Claim(words, criterion, table.columns, rows, remark, own=found, **kind)
    return found


def _criterion(clause: Mapping[str, Any]) -> str:
    """Return the criterion that the first row implies: "beats" or "stays below"."""
    rule = clause["rows"][0].partition(":")[2]
    winners, losers = re.split(r" (?:beats?|below) ", rule.strip())
    names, one = winners.replace(" ", " and "), " " not in winners
    if " below " in rule:
        return f"{names} {'stays' if one else 'stay'} below the bound of each row"
    return (
        f"{names} {'is' if one else 'are'} better than {losers.replace(' ', ' and ')} in every row"
    )


def beyond_part(data: Data, part: Mapping[str, Any]) -> Part:
    """Return a section beyond the paper, whose statements are ours."""
    name = part["name"]
    section = (getattr(beyond, name, None) or getattr(design, name))(data)
    panels = figure.panels(part["panels"], section.curves)
    drawn = Figure(name, part["title"], part["alt"], panels)
    statements = []
    for one, rows in zip(part["statement"], section.rows, strict=True):
        remark, columns = one.get("remark", "").format_map(section.facts), one.get("columns")
        claim = Claim("", one["criterion"], columns or COLUMNS, rows, remark)
        statements.append(Statement(one["says"], [claim]))
    anchor, notes = f"beyond-{name}", part.get("notes", ())
    return Part(anchor, part["heading"], "", notes, drawn, statements)
