"""What a person sees of results, systems and instances: pictures, HTML and lines of text."""

import base64
import contextlib
import os
import pty
import re
import subprocess
import termios
import time
from types import SimpleNamespace

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter
from lxml import etree, html
from matplotlib import pyplot

from conftest import ROOT
from fmu_master import (
    Instance,
    Message,
    Result,
    Sweep,
    System,
    compare,
    python_component,
    sweep,
)
from fmu_master.plots import extremes
from fmu_master.result import Messages
from pendulum_fmus.project import PROGRAM

PENDULUM = ROOT / "target" / "fmu" / "Pendulum.fmu"
LOOP = ROOT / "examples" / "closed-loop" / "pid.toml"

SIGNALS = {
    "reference": "source.r",
    "output": "plant.theta",
    "error": "controller.e",
    "control": "controller.u",
}


def titles(figure):
    """Return the titles of the pictures of a figure."""
    return [axis.get_title(loc="left") for axis in figure.axes]


def lines(axis):
    """Return the lines of a picture by name."""
    return {line.get_label(): line for line in axis.lines}


@pytest.fixture(scope="module")
def loop(fmus):
    return System(LOOP).simulate(stop_time=0.5)


@pytest.fixture(scope="module")
def machine():
    """Return a result with columns of all kinds."""
    time = np.linspace(0.0, 2.0, 401)
    columns = {
        "time": time,
        "mode": np.where(time < 1, 1, 2),
        "on": time % 0.5 >= 0.25,
        "count": (5 * time).astype(int),
        "label": np.where(time < 1, "idle", "running").astype(object),
        "q[1]": time,
        "q[2]": time**2,
    }
    result = Result.of(columns, {"q[1]": "m", "q[2]": "m"})
    result.enumerations = {"mode": {1: "linear", 2: "square", 3: "cubic"}}
    return result


def test_a_picture_has_the_name_of_its_signal_and_the_set_point_that_it_follows(loop):
    figure = loop.plot()
    assert "plant.theta" in titles(figure)
    assert "source.r" not in titles(figure)
    axis = figure.axes[titles(figure).index("plant.theta")]
    assert axis.get_ylabel() == "[rad]"
    assert set(lines(axis)) == {"plant.theta", "source.r"}
    assert [text.get_text() for text in axis.get_legend().texts] == ["source.r", "plant.theta"]
    assert {axis.get_xlabel() for axis in figure.axes} == {"", "time [s]"}
    assert figure.axes[-1].get_xlabel() == "time [s]"


def test_sampled_signals_are_steps_and_continuous_ones_are_not(loop):
    drawn = {name: line for axis in loop.plot().axes for name, line in lines(axis).items()}
    assert drawn["controller.u"].get_drawstyle() == "steps-post"
    assert drawn["plant.theta"].get_drawstyle() == "default"
    assert "controller.u" in loop.held
    assert "plant.theta" not in loop.held


def test_a_table_of_a_file_has_its_set_points_by_names():
    time = np.arange(3.0)
    table = Result.of({"time": time, "speed": time, "speed_ref": time}, {})
    assert table.set_points == {"speed": "speed_ref"}
    assert titles(table.plot()) == ["speed"]
    assert titles(table.plot("speed_ref")) == ["speed_ref"]


def test_values_with_names_have_them_on_an_axis_and_booleans_are_bands(machine):
    figure = machine.plot()
    assert titles(figure) == ["mode", "on", "count", "label", "q"]
    mode, on, count, label, q = figure.axes
    assert [tick.get_text() for tick in mode.get_yticklabels()] == ["linear", "square", "cubic"]
    assert lines(mode)["mode"].get_drawstyle() == "steps-post"
    assert [tick.get_text() for tick in label.get_yticklabels()] == ["idle", "running"]
    assert not on.lines
    spans = [path.get_extents() for path in on.collections[0].get_paths()]
    assert [(span.x0, span.x1) for span in spans] == [
        (pytest.approx(begin), pytest.approx(begin + 0.25)) for begin in (0.25, 0.75, 1.25, 1.75)
    ]
    assert lines(count)["count"].get_drawstyle() == "steps-post"
    assert set(lines(q)) == {"q[1]", "q[2]"}
    assert q.get_ylabel() == "[m]"


def test_names_choose_pictures_and_a_tuple_shares_one(machine):
    assert titles(machine.plot("q")) == ["q"]
    assert titles(machine.plot([("count", "q[1]"), "on"])) == ["count, q[1]", "on"]
    with pytest.raises(KeyError, match="nosuch is not recorded"):
        machine.plot(["nosuch"])


def test_runs_that_are_compared_differ_in_colour_and_dashes(loop):
    other = System(LOOP).simulate({"controller.pid.kp": 100.0}, stop_time=0.5)
    figure = loop.plot("plant.theta", over={"kp = 100": other}, label="kp = 300")
    (axis,) = figure.axes
    one, two = (line for line in axis.lines if line.get_label() == "plant.theta")
    assert np.array_equal(two.get_ydata(), other["plant.theta"])
    assert one.get_color() != two.get_color()
    assert one.get_linestyle() != two.get_linestyle()
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.texts] == ["kp = 300", "kp = 100"]
    assert len(loop.plot("plant.theta", over=[other, other]).legends[0].texts) == 3


def test_a_picture_of_many_rows_has_few_points_with_all_extremes():
    count = 1_000_000
    values = np.sin(np.arange(count) * 1e-3)
    values[123_456], values[654_321], values[500_000] = 9.0, -9.0, np.nan
    result = Result.of({"time": np.arange(count) * 1e-3, "a": values}, {})
    drawn = result.plot().axes[0].lines[0].get_ydata()
    assert len(drawn) < 5000
    assert (np.nanmax(drawn), np.nanmin(drawn)) == (9.0, -9.0)
    assert np.isnan(drawn).sum() == 1
    rows = extremes(values)
    assert (rows[0], rows[-1]) == (0, count - 1)
    assert np.all(np.diff(rows) > 0)
    assert extremes(np.full(10_000, np.nan)).size < 3000
    assert extremes(values[:3000]).tolist() == list(range(3000))


def table(kp, mass, iae, **others):
    """Return the table of a sweep."""
    index = np.arange(len(kp))
    columns = {"index": index, "c.kp": kp, "p.M": mass, "iae": iae, "diverged": np.isnan(iae)}
    return Result.of(columns | others, {})


def test_a_sweep_shows_each_parameter_its_failures_and_a_best_run_at_the_edge():
    kp = np.linspace(100.0, 400.0, 10_000)
    iae = np.where(kp < 150, np.nan, 5.0 - kp / 100)
    figure = table(kp, np.full(10_000, 1.0), iae).plot()
    run, parameter = figure.axes
    assert (run.get_xlabel(), parameter.get_xlabel()) == ("run", "c.kp")
    assert lines(run)["best"].get_xdata() == [9999]
    assert max(lines(parameter)["diverged or failed"].get_xdata()) < 150
    assert "10000 runs, 1667 diverged or failed" in figure.get_suptitle()
    assert "c.kp = 400, at the end of the range (100 to 400)" in figure.get_suptitle()
    assert "p.M" not in figure.get_suptitle()


def test_two_parameters_of_a_sweep_are_a_map():
    kp, mass = (part.ravel() for part in np.meshgrid([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]))
    figure = table(kp, mass, (kp - 2) ** 2 + (mass - 2) ** 2 + 1).plot()
    chart = figure.axes[3]
    assert (chart.get_xlabel(), chart.get_ylabel()) == ("c.kp", "p.M")
    assert chart.collections[0].get_array().tolist() == [[3, 2, 3], [2, 1, 2], [3, 2, 3]]
    assert "range" not in figure.get_suptitle()


def test_a_comparison_shows_how_far_each_variable_is_off(loop):
    columns = {name: column.copy() for name, column in loop.items()}
    columns["plant.x"][100:] += 0.5
    axes = compare(loop, columns).plot().axes
    assert [axis.get_title(loc="left") for axis in axes] == ["plant.x", "results - reference"]
    assert axes[1].lines[0].get_ydata()[-1] == pytest.approx(0.5)


# --- notebooks and terminals --------------------------------------------------------------------


def rows(shown):
    """Return the cells of the tables in HTML."""
    page = html.fromstring(shown)
    return [[cell.text_content() for cell in row] for row in page.iter("tr")]


def test_a_notebook_shows_the_signals_of_a_run_and_the_same_picture_twice(loop):
    shown, _ = DisplayFormatter().format(loop)
    assert shown["text/plain"] == repr(loop)
    theta = next(row for row in rows(shown["text/html"]) if row[0] == "plant.theta")
    expected = (f"{number:.5g}" for number in loop.summary["plant.theta"].values())
    low, high, _, last = expected
    assert theta == ["plant.theta", "rad", low, high, last]
    (source,) = re.findall(r'src="data:image/png;base64,([^"]+)"', shown["text/html"])
    assert base64.b64decode(source) == shown["image/png"]


def test_a_notebook_shows_a_figure_once_with_and_without_pyplot(machine):
    shown_by_pyplot = pyplot.get_fignums()
    shown, _ = DisplayFormatter().format(machine.plot("q"))
    assert shown["image/png"].startswith(b"\x89PNG")
    assert pyplot.get_fignums() == shown_by_pyplot


def test_a_terminal_with_ipython_draws_no_picture(machine, monkeypatch):
    shell = SimpleNamespace(display_formatter=SimpleNamespace(active_types=["text/plain"]))
    monkeypatch.setattr("IPython.get_ipython", lambda: shell)
    assert machine._repr_mimebundle_() == {"text/plain": repr(machine)}


def test_texts_are_escaped():
    planted = "<script>alert(1)</script>"
    result = Result.of({"time": [0.0], planted: [1.0]}, {planted: "<b>"})
    result.alarms, result.notes = [planted], [planted]
    result.messages = Messages([Message(planted, "warning", planted, 1, planted)])
    part = python_component([], ["y"], lambda t: t)
    system = System(components={planted: part, "other": part}, connections=[])
    failure = np.array([planted], object)
    runs = Result.of({"index": [0], planted: [1.0], "iae": [2.0], "failure": failure}, {})
    changed = compare(result, {"time": [0.0], planted: [2.0]})
    for shown in (result, result.messages, system, runs, changed):
        text = shown._repr_html_()
        assert planted not in text
        assert "&lt;script&gt;" in text
        assert "<script" not in text


def test_a_run_tells_alarms_and_warnings_in_html_and_in_a_terminal(machine, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    told = Result.of(machine, machine.units)
    told.alarms, told.notes = ["diverging: q"], ["one word after the other " * 6]
    told.messages = Messages([Message("a", "error", "no convergence", 3, "logModel")])
    page = html.fromstring(told._repr_html_())
    texts = [line.text_content() for line in page.iter("p")]
    assert "alarm: diverging: q" in texts
    assert "error: a: no convergence (3 times)" in texts
    lines = str(told).splitlines()
    assert "alarm: diverging: q" in lines
    assert max(map(len, lines)) <= 80


def test_a_sweep_shows_its_best_runs_and_failures(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    failure = np.array([None, "<no licence>", None, None], object)
    iae = np.array([3.0, np.nan, 1.0, 2.0])
    runs = table(np.array([1.0, 2.0, 3.0, 4.0]), np.ones(4), iae, failure=failure)
    shown = rows(runs._repr_html_())
    assert shown[:3] == [["run", "c.kp", "iae"], ["2", "3", "1"], ["3", "4", "2"]]
    assert ["1", "<no licence>"] in shown
    assert "4 runs, 1 diverged or failed" in str(runs)
    assert max(map(len, str(runs).splitlines())) <= 80


def test_a_system_shows_its_blocks_and_connections():
    system = System(LOOP)
    assert repr(system) == "<System pid.toml: controller, plant, source; 4 connections>"
    shown = system._repr_html_()
    assert ["plant.theta", "controller.y"] in rows(shown)
    (diagram,) = re.findall(r"<svg.*</svg>", shown, re.DOTALL)
    texts = [text.text for text in etree.fromstring(diagram).iter("text")]
    assert {"controller", "plant", "source", "r → r, d → d", "theta → y"} <= set(texts)
    assert "plant.theta -> controller.y" in str(system)
    assert repr(System(PENDULUM)) == f"<System {PENDULUM.name}>"
    assert "nosuch.toml" in repr(System("nosuch.toml"))


def test_an_instance_shows_its_variables_by_causality_and_is_not_initialized_by_that(fmus):
    with Instance(PENDULUM, start_values={"theta0": 0.25}) as plant:
        assert repr(plant) == f"<Instance: {PENDULUM.stem}, t = 0 s, not initialized>"
        before = rows(plant._repr_html_())
        assert ["input", "unit", "type", "start", "description"] in before
        assert "not initialized" in repr(plant)
        assert next(row for row in before if row[0] == "theta0")[3] == "0.25"
        plant.step(0.001)
        after = rows(plant._repr_html_())
        theta = next(row for row in after if row[0] == "theta")
        assert theta[1:4] == ["rad", "Float64", f"{plant.get('theta'):.5g}"]
    assert repr(plant) == f"<Instance: {PENDULUM.stem}, t = 0.001 s>"
    assert "Instance" in plant._repr_html_()


def test_lines_of_a_terminal_have_at_most_80_columns(loop):
    columns = {f"a.long.name[{k}]": loop["time"] for k in range(1, 40)}
    wide = Result.of({"time": loop["time"]} | columns, {})
    changed = compare(wide, {"time": loop["time"], **{n: c + 1 for n, c in columns.items()}})
    part = python_component(["y"], ["u"], lambda t, y: -y)
    system = System(components={f"component{k}": part for k in range(30)})
    planned = Sweep({name: [1.0] for name in columns}, system, signals=SIGNALS)
    for shown in (wide, changed, part, system, planned):
        assert len(repr(shown)) <= 80
        assert " object at " not in repr(shown)


# --- the command line ---------------------------------------------------------------------------


def terminal(*arguments, columns=80):
    """Return what the command line shows on a terminal."""
    ours, its = pty.openpty()
    termios.tcsetwinsize(its, (24, columns))
    command = [PROGRAM, *map(str, arguments)]
    shown = b""
    with subprocess.Popen(command, stdout=its, stderr=its, env=os.environ | {"TERM": "xterm"}):
        os.close(its)
        with contextlib.suppress(OSError):  # end of file on Linux
            while some := os.read(ours, 4096):
                shown += some
    os.close(ours)
    return re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown.decode()).replace("\r\n", "\n")


def test_lines_of_the_command_line_have_at_most_80_columns_on_a_terminal(fmus, tmp_path):
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    system = ("simulate", LOOP, "--stop=1")
    changes = ("--set", "controller.pid.kp=200")
    commands = [
        ("info", PENDULUM),
        ("validate", PENDULUM),
        (*system, "--csv", files[0]),
        (*system, *changes, "--csv", files[1]),
        ("compare", *files),
        ("simulate", LOOP, "--set", "controller.pid.no_such_parameter_of_this_controller=1"),
    ]
    for command in commands:
        shown = terminal(*command)
        lines = [
            line.rpartition("\r")[2] for line in shown.split("\n") if str(tmp_path) not in line
        ]
        assert max(map(len, lines)) <= 80, shown


def test_a_terminal_shows_whole_descriptions_of_variables(fmus):
    shown = terminal("info", ROOT / "target" / "fmu" / "Pid.fmu")
    words = " ".join(shown.split())
    assert "would drive the force further beyond the limit" in words
    assert "anti_windup fixed parameter, Boolean, start false" in words


def test_progress_is_told_in_numbers_of_a_person(fmus, capsys):
    slow = python_component([], ["y"], lambda t: time.sleep(0.06) or t)
    System(components={"clock": slow}, step=0.5, stop=4.0).simulate(progress=True)
    shown = capsys.readouterr().err
    assert re.search(r"t = [1-4]\.\d+ of 4 s, \d+(\.\d+)? times real time, \d+ s left", shown)


def test_a_sweep_tells_how_many_runs_are_done(fmus, capsys):
    values = {"controller.pid.kp": [100.0, 200.0]}
    sweep(values, LOOP, signals=SIGNALS, stop=0.5, progress=True)
    assert "0 of 2 runs" in capsys.readouterr().err
    sweep(values, LOOP, signals=SIGNALS, stop=0.5)
    assert capsys.readouterr().err == ""
