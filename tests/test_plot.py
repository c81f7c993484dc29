"""The pages with traces of runs and with sweeps, in a real browser."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import sweeps
from native import LOOPS, read_csv, run
from test_native import binaries, relay

__all__ = ["binaries", "relay"]  # fixtures

SYSTEM = LOOPS / "pid.toml"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> tuple[Path, list[dict[str, np.ndarray]]]:
    """Return a page with two runs, and their rows."""
    folder = tmp_path_factory.mktemp("plot")
    page, files = folder / "page.html", [folder / "a.csv", folder / "b <&.csv"]
    run("simulate", SYSTEM, "--csv", files[1], "--stop=1", "--step=0.002")
    gain = "--set=controller.pid.kp=300"
    plot = ("--csv", files[0], "--plot", page, "--over", files[1])
    result = run("simulate", SYSTEM, "--stop=2", gain, *plot)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.endswith(f"wrote {page}\n")
    return page, [read_csv(file) for file in files]


def opened(browser: Browser, file: Path, width: int, scheme: str) -> Page:
    """Open a page, which must say nothing, ask for nothing, and fit the screen."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-drawn]", state="attached")
    assert (said, asked) == ([], [file.as_uri()])
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    return page


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_the_page_draws_all_runs_and_shows_the_values_at_the_cursor(
    browser: Browser, drawn, width, scheme
):
    file, runs = drawn
    page = opened(browser, file, width, scheme)

    for shown, rows in zip(json.loads(page.inner_text("#runs")), runs, strict=True):
        names = [column["name"] for column in shown["columns"]]
        assert ["time", *names] == list(rows)
        np.testing.assert_array_equal(shown["time"], rows["time"])
        for column in shown["columns"]:
            expected = np.broadcast_to(column["values"], len(rows["time"]))
            np.testing.assert_allclose(expected, rows[column["name"]], rtol=1e-6)
    units = {column["unit"] for column in shown["columns"]}
    assert (
        page.locator(".uplot").count()
        == len(units)
        == int(page.get_attribute("body", "data-drawn"))
    )

    plot = page.locator(".uplot", has_text="plant.theta (this run)")
    border = "getComputedStyle(mark).borderTopStyle"
    borders = plot.locator(".u-marker").evaluate_all(f"marks => marks.map((mark) => {border})")
    assert {"solid", "dashed"} <= {*borders}, "the legend shows which run a curve is of"
    over = plot.locator(".u-over")
    over.hover()
    labels, shown = (plot.locator(f".u-{part}").all_inner_texts() for part in ("label", "value"))
    values = dict(zip(labels, shown, strict=True))
    row = np.flatnonzero(np.isclose(runs[0]["time"], float(values["time [s]"]), atol=1e-6))
    assert float(values["plant.theta (this run)"]) == pytest.approx(
        runs[0]["plant.theta"][row[0]], rel=1e-6
    )
    page.context.close()


GRID = """
stop = 0.5
metrics = { limit = 1.0 }
parameter = [
    { variable = "controller.pid.kp", values = [100, 200, 400] },
    { variable = "controller.pid.kd", from = 1, to = 100, count = 3, scale = "log" },
    { variable = "source.signal", values = ["sine", "square"] },
]
"""


def test_the_page_shows_the_names_of_items_and_texts(browser: Browser, relay, tmp_path):
    texts = ["a.choice", "b.choice", "a.label"]
    start = {"a": {"shape": "square"}, "b": {}}
    system = relay(start, (), outputs=[*texts, "a.count"])
    run("simulate", system, "--csv", tmp_path / "a.csv", "--plot", tmp_path / "a.html")
    page = opened(browser, tmp_path / "a.html", 1400, "light")
    assert page.locator("h2").all_inner_texts() == [*texts, "without unit"]
    plot = page.locator(".uplot", has_text="a.choice")
    plot.locator(".u-over").hover()
    assert plot.locator(".u-value").all_inner_texts()[1] == "square"
    page.context.close()


@pytest.mark.parametrize(
    ("parameters", "width", "scheme"), [(1, 1400, "light"), (2, 390, "dark"), (3, 390, "light")]
)
def test_the_page_of_a_sweep_shows_the_best_run_and_the_one_at_the_cursor(
    browser: Browser, fmus, tmp_path, parameters, width, scheme
):
    lines = GRID.splitlines()
    text = "\n".join([*lines[: 4 + parameters], "]"])
    page_file, out = tmp_path / "page.html", tmp_path / "rows.csv"
    result = sweeps.local(sweeps.written(tmp_path, text), out, "--plot", page_file)
    assert (result.returncode, result.stderr) == (0, "")
    rows = sweeps.table(out)
    page = opened(browser, page_file, width, scheme)
    shown = page.locator("#shown")
    best = re.search(r"smallest iae, .*: run (\d+)", result.stdout)[1]
    assert shown.inner_text().startswith(f"run {best}, the best: ")
    failed = [row["index"] for row in rows if row["diverged"] == "true"]
    listed = page.locator("#failed td:first-child").all_inner_texts()
    assert listed == failed[:10]
    assert failed or parameters == 1

    page.locator("#plot").hover(position={"x": width // 3, "y": 90})
    row = rows[int(shown.get_attribute("data-run"))]
    values = dict(re.findall(r"([\w.]+) = ([\w.+-]*\w)", shown.inner_text()))
    names = list(row)[1 : 1 + parameters]
    assert {"iae", *names} <= set(values)
    for name, value in values.items():
        if name == "source.signal":
            assert value == row[name]
        else:
            assert float(value) == pytest.approx(float(row[name]), rel=1e-5)
    page.select_option("select", "largest_u")
    assert page.locator("#best th").all_inner_texts()[:2] == ["run", "largest_u"]
    page.context.close()
