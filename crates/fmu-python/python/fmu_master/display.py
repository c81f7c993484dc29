"""What notebooks and terminals show of results, systems and instances: HTML, text and diagrams."""

from __future__ import annotations

import base64
import os
import shutil
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ._runs import INDEX, Runs, is_table

if TYPE_CHECKING:
    from .comparison import Comparison
    from .components import PythonComponent
    from .instance import Instance, Variable
    from .result import Message, Result
    from .system import System

_MOST = 30
"""The most rows of a table that are shown."""

_STYLE = """<style>
.fmu-master { max-width: 100%; overflow-x: auto; line-height: 1.45; }
.fmu-master p { margin: .3em 0; }
.fmu-master table { border-collapse: collapse; margin: .4em 0; color: inherit; }
.fmu-master table :is(tr, th, td) { background: none; color: inherit; text-align: left; }
.fmu-master table :is(th, td) { padding: .15em .8em .15em 0; border: 0; vertical-align: top;
  border-bottom: 1px solid rgba(128, 128, 128, .35); }
.fmu-master table .number { text-align: right; font-variant-numeric: tabular-nums; }
.fmu-master .note, .fmu-master .alarm { border-left: 3px solid #888; padding-left: .6em; }
.fmu-master .alarm { border-color: #d97706; }
.fmu-master img, .fmu-master svg { max-width: 100%; height: auto; }
</style>"""
# The colours of text are those of the notebook, which may be light or dark.


# --- parts --------------------------------------------------------------------------------------


def count(number: int, thing: str) -> str:
    """Return a number of things, such as "1 row" or "2 rows"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def listed(begin: str, names: Iterable[str], end: str, width: int = 80) -> str:
    """Return a line with as many names as fit, and how many more there are."""
    all_names = list(names)
    text = f"{begin}{', '.join(all_names)}{end}"
    for shown in range(len(all_names) - 1, -1, -1):
        if len(text) <= width:
            break
        more = [*all_names[:shown], f"{len(all_names) - shown} more"]
        text = f"{begin}{', '.join(more)}{end}"
    return text


def _cell(value: Any) -> str:
    """Return a value as a person reads it."""
    value = value.item() if isinstance(value, np.generic) else value
    match value:
        case None:
            return ""
        case bool():
            return str(value).lower()
        case float():
            return f"{value:.5g}" if value == value else "–"
        case bytes():
            return count(len(value), "byte")
        case np.ndarray() | list() | tuple():
            parts = np.ravel(np.asarray(value, object)).tolist()
            return f"[{', '.join(map(_cell, parts[:6]))}{', …' * (len(parts) > 6)}]"
    return textwrap.shorten(str(value), 200, placeholder=" …")


def _page(*parts: str) -> str:
    return f'<div class="fmu-master">{_STYLE}{"".join(parts)}</div>'


def _paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def _head(title: str, text: str) -> str:
    return f"<p><b>{escape(title)}</b> {escape(text)}</p>"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table, in which numbers are to the right."""

    def line(cells: Sequence[Any], tag: str) -> str:
        parts = []
        for number, cell in enumerate(cells):
            kind = ' class="number"' if number in numbers else ""
            parts.append(f"<{tag}{kind}>{escape(_cell(cell))}</{tag}>")
        return f"<tr>{''.join(parts)}</tr>"

    numbers = _numbers(rows)
    body = "".join(line(row, "td") for row in rows[:_MOST])
    more = _paragraph(f"… and {len(rows) - _MOST} more") if len(rows) > _MOST else ""
    return f"<table><thead>{line(head, 'th')}</thead><tbody>{body}</tbody></table>{more}"


def _numbers(rows: Sequence[Sequence[Any]]) -> set[int]:
    """Return the columns that have numbers."""
    real = (float, int, np.number)
    columns = enumerate(zip(*rows, strict=True))
    return {number for number, cells in columns if any(isinstance(c, real) for c in cells)}


def _lines(head: Sequence[str], rows: Sequence[Sequence[Any]], width: int) -> list[str]:
    """Return a table as lines of text: numbers that do not fit into the width are left out."""
    cells = [list(head), *([_cell(cell) for cell in row] for row in rows[:_MOST])]
    widths = [min(max(map(len, column)), 32) for column in zip(*cells, strict=True)]
    numbers = _numbers(rows)
    while sum(widths) + 2 * len(widths) > width and len(widths) - 1 in numbers:
        widths.pop()
    lines = []
    for row in cells:
        parts = [
            cell.rjust(size) if number in numbers else _cut(cell, size).ljust(size)
            for number, (cell, size) in enumerate(zip(row, widths, strict=False))
        ]
        lines.append(_cut(f"  {'  '.join(parts)}".rstrip(), width))
    return [*lines, f"  … and {len(rows) - _MOST} more"] if len(rows) > _MOST else lines


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def _width() -> int:
    return max(shutil.get_terminal_size((80, 24)).columns, 40)


def _is_text_only() -> bool:
    """Return whether this is IPython in a terminal, which shows no pictures."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    formatter = getattr(shell, "display_formatter", None)
    return formatter is not None and "text/html" not in formatter.active_types


# --- results ------------------------------------------------------------------------------------


def result_bundle(result: Result) -> dict[str, Any]:
    """Return a result for a notebook: as HTML with its picture, as the picture, and as text."""
    text = {"text/plain": repr(result)}
    if _is_text_only():
        return text
    picture = _picture(result)
    html = {"text/html": result_html(result, picture)}
    return text | html | ({} if picture is None else {"image/png": picture})


def _picture(result: Result) -> bytes | None:
    try:
        from .plots import png
    except ImportError:
        return None  # without Matplotlib
    is_empty = len(result) < 2 or not len(next(iter(result.values())))
    return None if is_empty else png(result)


def result_html(result: Result, picture: bytes | None = None) -> str:
    """Return a result as HTML: its signals or best runs, what is wrong, and a picture."""
    parts = _sweep_parts(Runs(result)) if is_table(result) else _run_parts(result)
    if picture is not None:
        data = base64.b64encode(picture).decode()
        parts.append(f'<img alt="Plot of the result" src="data:image/png;base64,{data}">')
    return _page(*parts)


def result_line(result: Result) -> str:
    """Return how many rows and which columns a result has, in a line of a terminal."""
    column = next(iter(result.values()), np.empty(0))
    is_run = len(column) and "time" in result
    span = f", t = {column[0]:g} to {column[-1]:g} s" if is_run else ""
    return listed(f"<Result: {count(len(column), 'row')}{span}: ", result, ">")


def result_text(result: Result) -> str:
    """Return a result as text for a terminal: its signals, and what is wrong."""
    width = _width()
    if is_table(result):
        return _sweep_text(Runs(result), width)
    lines = [_about(result), *_lines(_SIGNALS, _signals(result), width)]
    for kind, text in _remarks(result):
        lines += textwrap.wrap(f"{kind}: {text}", width, subsequent_indent="  ")
    return "\n".join(lines)


_SIGNALS = ("signal", "unit", "min", "max", "last")


def _about(result: Result) -> str:
    """Return how much there is of a result, and how long it took."""
    column = next(iter(result.values()), np.empty(0))
    texts = [count(len(column), "row")]
    if len(column) and "time" in result:
        texts.append(f"t = {column[0]:g} to {column[-1]:g} s")
    if result.duration:
        texts.append(f"simulated in {_duration(result.duration)}")
    return f"Result: {', '.join(texts)}"


def _duration(seconds: float) -> str:
    return f"{seconds * 1e3:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _signals(result: Result) -> list[list[Any]]:
    """Return a row for each signal: name, unit, smallest, largest and last value."""
    rows = []
    for name in list(result)[1:]:
        column, items = result[name], result.enumerations.get(name)
        last = column[-1] if len(column) and column[-1] is not np.ma.masked else None
        low = high = None
        if items is not None:
            last = last if last is None else items.get(int(last), last)
        elif np.ma.count(column) and column.dtype.kind in "fiu":
            low, high = column.min(), column.max()
        rows.append([name, result.units.get(name, ""), low, high, last])
    return rows


def _remarks(result: Result) -> list[tuple[str, str]]:
    """Return what the user should know of a run: the kind and the text of each remark."""
    remarks = [("alarm", text) for text in result.alarms]
    remarks += [("ended", result.ended)] if result.ended else []
    problems = [message for message in result.messages if message.warning]
    remarks += [(message.level, _message(message)) for message in problems[:5]]
    if len(problems) > 5:
        remarks.append(("note", f"{len(problems) - 5} more warnings are in `messages`"))
    return remarks + [("note", text) for text in result.notes]


def _run_parts(result: Result) -> list[str]:
    title, text = _about(result).split(" ", 1)
    remarks = [
        _paragraph(f"{kind}: {text}", "note" if kind == "note" else "alarm")
        for kind, text in _remarks(result)
    ]
    return [_head(title, text), *remarks, _table(_SIGNALS, _signals(result))]


# --- sweeps -------------------------------------------------------------------------------------


def _sweep_about(runs: Runs) -> str:
    failed = int(runs.failed.sum())
    others = f", {failed} diverged or failed" if failed else ""
    return f"{count(len(runs), 'run')}{others}"


def _best(runs: Runs) -> tuple[list[str], list[list[Any]]]:
    """Return the head and the rows of a table of the best runs."""
    metrics = runs.metrics
    rows = runs.best(metrics[0], 5) if metrics else []
    names = [INDEX, *(name.split(", ")[0] for name in runs.varied), *metrics]
    head = ["run", *runs.varied, *metrics]
    return head, [[runs.table[name][row] for name in names] for row in rows]


def _sweep_parts(runs: Runs) -> list[str]:
    parts = [_head("Sweep:", _sweep_about(runs))]
    head, rows = _best(runs)
    if rows:
        parts += [_paragraph(f"Best by {head[1 + len(runs.varied)]}:"), _table(head, rows)]
        hints = runs.edges(runs.metrics[0]).values()
        parts += [_paragraph(hint, "note") for hint in hints]
    if failures := runs.failures:
        shown = [[index, text] for index, text in failures[:3]]
        parts += [_table(["failed run", "failure"], shown)]
        if len(failures) > len(shown):
            parts.append(_paragraph(f"… and {len(failures) - len(shown)} more"))
    names = [INDEX, *(name.split(", ")[0] for name in runs.varied), *runs.metrics[:4]]
    first = [[runs.table[name][row] for name in names] for row in range(min(len(runs), 5))]
    return [*parts, _paragraph("First runs:"), _table(names, first)]


def _sweep_text(runs: Runs, width: int) -> str:
    lines = [f"Sweep: {_sweep_about(runs)}"]
    head, rows = _best(runs)
    if rows:
        lines += [f"best by {head[1 + len(runs.varied)]}:", *_lines(head, rows, width)]
    texts = list(runs.edges(runs.metrics[0]).values()) if rows else []
    texts += [f"run {index} failed: {text}" for index, text in runs.failures[:3]]
    for text in texts:
        lines += textwrap.wrap(text, width, subsequent_indent="  ")
    return "\n".join(lines)


# --- messages and comparisons -------------------------------------------------------------------


def _message(message: Message) -> str:
    times = f" ({message.times} times)" if message.times > 1 else ""
    return f"{message.instance}: {message.text}{times}"


def messages_html(messages: Sequence[Message]) -> str:
    """Return messages of FMUs as HTML."""
    if not messages:
        return _page(_paragraph("No messages"))
    rows = [[m.level, m.instance, m.text, m.times, m.category] for m in messages]
    head = ("level", "instance", "message", "times", "category")
    return _page(_head("Messages:", str(len(messages))), _table(head, rows))


def comparison_html(comparison: Comparison) -> str:
    """Return the outcome of a comparison as HTML."""
    about = _head("Comparison:", str(comparison).rpartition("\n")[2])
    if comparison.is_same:
        return _page(about)
    head = ("variable", "differs at [s]", "reference", "results")
    rows = [[d.name, d.time, *d.values] for d in comparison.differences]
    return _page(about, _table(head, rows))


# --- systems ------------------------------------------------------------------------------------


class Blocks:
    """The components of a system, and their connections.

    Attributes
    ----------
    components : list of (str, str, dict)
        Name, FMU and start values of each.
    connections : list of (str, str, str)
        Output, input, and what happens to the value on the way.
    times : str
        Start time, stop time and communication step.
    """

    def __init__(self, system: System):
        self.components: list[tuple[str, str, dict[str, Any]]] = []
        self.connections: list[tuple[str, str, str]] = []
        self.times = ""
        try:
            keys = system.keys()
        except Exception:  # whatever is wrong with the file: a run says so
            return
        for table in keys.get("component", ()):
            fmu = table.get("fmu", "")
            is_file = isinstance(fmu, str | os.PathLike)
            name = os.path.basename(fmu) if is_file else _function(fmu)
            self.components.append((str(table.get("name")), name, dict(table.get("start") or {})))
        for given in keys.get("connections", ()):
            if isinstance(given, Mapping):
                one, other = str(given.get("from")), str(given.get("to"))
                remarks = [f"{k} {_cell(given[k])}" for k in ("factor", "offset") if k in given]
                faults = [name for fault in given.get("faults", ()) for name in list(fault)[:1]]
                self.connections.append((one, other, ", ".join(remarks + faults)))
            else:
                one, _, other = str(given).partition("->")
                self.connections.append((one.strip(), other.strip(), ""))
        if "stop" in keys:
            self.times = f"t = {_cell(keys.get('start', 0))} to {_cell(keys['stop'])} s"
        if "step" in keys:
            self.times += f"{', ' * bool(self.times)}step {_cell(keys['step'])} s"


def _function(component: Any) -> str:
    step = getattr(component, "step", component)
    name = getattr(step, "__qualname__", type(step).__name__)
    return f"{name.rpartition('<locals>.')[2]} (Python)"


def component_line(component: PythonComponent) -> str:
    """Return a component in Python as a line."""
    inputs = ", ".join(component.inputs) or "no input"
    begin, end = f"<PythonComponent: {_cut(inputs, 24)} -> ", f"; {_function(component)}>"
    return listed(begin, component.outputs, end)


def _system_about(system: System, blocks: Blocks) -> str:
    file = "" if system.description is not None else system.file.name
    if not blocks.components:
        return file
    texts = [file] if file else []
    texts.append(count(len(blocks.components), "component"))
    texts.append(count(len(blocks.connections), "connection"))
    return ", ".join([*texts, blocks.times] if blocks.times else texts)


def system_line(system: System) -> str:
    """Return a system as a line."""
    blocks = Blocks(system)
    name, connections = type(system).__name__, len(blocks.connections)
    file = f" {system.file.name}" if system.description is None else ""
    end = f"; {count(connections, 'connection')}>" if connections else ">"
    if not blocks.components:
        return f"<{name}{file}>"
    return listed(f"<{name}{file}: ", (component for component, *_ in blocks.components), end)


def _system_rows(blocks: Blocks) -> list[list[str]]:
    rows = []
    for name, fmu, start in blocks.components:
        rows.append([name, fmu, ", ".join(f"{k} = {_cell(v)}" for k, v in start.items())])
    return rows


def system_text(system: System) -> str:
    """Return a system as text: its components and connections."""
    blocks, width = Blocks(system), _width()
    about = f"{type(system).__name__}: {_system_about(system, blocks)}"
    lines = textwrap.wrap(about, width, subsequent_indent="  ")
    if blocks.components:
        lines += _lines(("component", "FMU", "start values"), _system_rows(blocks), width)
    lines += [
        _cut(f"  {one} -> {other}{f'  ({how})' if how else ''}", width)
        for one, other, how in blocks.connections
    ]
    return "\n".join(lines)


def system_html(system: System) -> str:
    """Return a system as HTML: a block diagram, its components and connections."""
    blocks = Blocks(system)
    parts = [_head(f"{type(system).__name__}:", _system_about(system, blocks))]
    if not blocks.components:
        return _page(*parts)
    parts.append(_diagram(blocks))
    parts.append(_table(("component", "FMU", "start values"), _system_rows(blocks)))
    if blocks.connections:
        has_remarks = any(how for *_, how in blocks.connections)
        rows = [row if has_remarks else row[:2] for row in blocks.connections]
        parts.append(_table(("from", "to", "by way of")[: len(rows[0])], rows))
    return _page(*parts)


_BOX = 44
"""Height of the box of a component [px]."""

_GAP = 130
"""Distance between the boxes, where the names of variables are [px]."""


def _diagram(blocks: Blocks) -> str:
    """Return a block diagram as SVG, in the colour of the text; nothing of a large system."""
    names = [name for name, *_ in blocks.components]
    wires: dict[tuple[str, str], list[str]] = {}
    for one, other, _ in blocks.connections:
        ends = [next((n for n in names if end.startswith(f"{n}.")), None) for end in (one, other)]
        if ends[0] is not None and ends[1] is not None:
            label = f"{one[len(ends[0]) + 1 :]} → {other[len(ends[1]) + 1 :]}"
            wires.setdefault((ends[0], ends[1]), []).append(label)
    if not 1 < len(names) <= 12:
        return ""
    layers = _layers(names, list(wires))
    widest = max(len(name) for name in names)
    width = max(90, 9 * widest + 20)
    places: dict[str, tuple[int, int]] = {}
    for layer, members in enumerate(layers):
        for row, name in enumerate(members):
            places[name] = (layer * (width + _GAP), row * (_BOX + 34))
    bottom = max(y for _, y in places.values()) + _BOX
    drawn, above, below = [], 0, bottom
    for (one, other), labels in wires.items():
        (x0, y0), (x1, y1) = places[one], places[other]
        out, into = y0 + _BOX // 2, y1 + _BOX // 2
        begin, end, title = x0 + width, x1, escape("\n".join(labels))
        text = escape(_cut(", ".join(labels), 20 if end - begin == _GAP else 48))
        if end - begin == _GAP:
            middle, height = (begin + end) // 2, (out + into) // 2
            path = f"M{begin} {out}C{middle} {out} {middle} {into} {end} {into}"
        else:
            if end > begin:
                above -= 22
                height = above
            else:
                below += 22
                height = below
            # An own place to leave and to arrive, beside the direct connections.
            out += 10 if height > 0 else -10
            into += 10 if height > 0 else -10
            right, left, middle = begin + 16, end - 16, (begin + end) // 2
            path = f"M{begin} {out}H{right}V{height}H{left}V{into}H{end}"
        drawn.append(
            f'<g><title>{title}</title><path d="{path}" fill="none" stroke="currentColor"/>'
            f'<path d="M{end} {into}l-7 -4v8z" fill="currentColor"/>'
            f'<text x="{middle}" y="{height - 5}" text-anchor="middle" font-size="11"'
            f' fill="currentColor">{text}</text></g>'
        )
    for name, fmu, _ in blocks.components:
        x, y = places[name]
        centre, attributes = x + width // 2, 'text-anchor="middle" fill="currentColor"'
        drawn.append(
            f'<g><title>{escape(fmu)}</title><rect x="{x}" y="{y}" width="{width}" height="{_BOX}"'
            ' rx="4" fill="none" stroke="currentColor"/>'
            f'<text x="{centre}" y="{y + 19}" font-size="13" {attributes}>{escape(name)}</text>'
            f'<text x="{centre}" y="{y + 35}" font-size="10" opacity=".7" {attributes}>'
            f"{escape(_cut(fmu, width // 6))}</text></g>"
        )
    across = max(x for x, _ in places.values()) + width
    box = (-22, above - 20, across + 44, below - above + 30)
    view = " ".join(map(str, box))
    return (
        f'<svg role="img" aria-label="Block diagram" viewBox="{view}" width="{box[2]}"'
        f' height="{box[3]}" font-family="sans-serif">{"".join(drawn)}</svg>'
    )


def _layers(names: Sequence[str], wires: Sequence[tuple[str, str]]) -> list[list[str]]:
    """Return the components in columns from left to right, except for what feeds back."""
    feeds: dict[str, list[str]] = {name: [] for name in names}
    for one, other in wires:
        feeds[one].append(other)
    fed = {other for one, other in wires if one != other}
    done: list[str] = []
    back: set[tuple[str, str]] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        for other in feeds[name]:
            if other in (*path, name):
                back.add((name, other))
            elif other not in done:
                visit(other, (*path, name))
        done.append(name)

    for name in sorted(names, key=lambda name: name in fed):
        if name not in done:
            visit(name, ())
    layer = dict.fromkeys(names, 0)
    for name in reversed(done):
        for other in feeds[name]:
            if (name, other) not in back:
                layer[other] = max(layer[other], layer[name] + 1)
    return [[n for n in names if layer[n] == k] for k in range(max(layer.values()) + 1)]


# --- instances ----------------------------------------------------------------------------------

_CAUSALITIES = "input output structuralParameter parameter calculatedParameter local".split()


def instance_html(instance: Instance, starts: Mapping[str, Any] | None) -> str:
    """Return an instance as HTML: its variables by causality, with their values.

    Of an instance that is not initialized, these are its start values, given or declared.
    """
    parts = [_head(f"{type(instance).__name__}:", instance_about(instance, starts is None))]
    try:
        variables = instance.variables.values()
    except RuntimeError:  # such as one that is freed
        return _page(*parts)
    title = "value" if starts is None else "start"
    for causality in _CAUSALITIES:
        rows: list[list[Any]] = []
        for variable in (v for v in variables if v.causality == causality):
            shown = [variable.name, variable.unit, variable.type]
            value = None if len(rows) >= _MOST else _value(instance, variable, starts)
            rows.append([*shown, value, variable.description])
        if rows:
            name = "".join(f" {c.lower()}" if c.isupper() else c for c in causality)
            parts.append(_table((name, "unit", "type", title, "description"), rows))
    return _page(*parts)


def _value(instance: Instance, variable: Variable, starts: Mapping[str, Any] | None) -> Any:
    """Return a value of an instance that is initialized, or a start value."""
    if starts is not None:
        return starts.get(variable.name, variable.start)
    try:
        return instance.get(variable.name)
    except RuntimeError:
        return variable.start


def instance_about(instance: Instance, is_initialized: bool) -> str:
    """Return the name and the state of an instance."""
    state = "" if is_initialized else ", not initialized"
    return f"{instance.name}, t = {instance.time:g} s{state}"
