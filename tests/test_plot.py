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


def data(page: Path) -> list[dict]:
    """Return the runs of a page."""
    return json.loads(re.search(r'id="runs">(.*?)</script>', page.read_text(), re.DOTALL)[1])


def column(shown: dict, name: str) -> dict:
    """Return a column of a run."""
    [found] = [column for column in shown["columns"] if column["name"] == name]
    return found


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
def test_the_page_draws_all_runs_and_shows_the_values_at_the_cursor(
    browser: Browser, drawn, width, scheme
):
    file, runs = drawn
    page = opened(browser, file, width, scheme)

    for shown, rows in zip(data(file), runs, strict=True):
        names = [column["name"] for column in shown["columns"]]
        assert ["time", *names] == list(rows)
        np.testing.assert_array_equal(shown["time"], rows["time"])
        for column in shown["columns"]:
            expected = np.broadcast_to(column["values"], len(rows["time"]))
            np.testing.assert_allclose(expected, rows[column["name"]], rtol=1e-6, atol=1e-6)

    # A picture for each variable but the set-point, which is in the picture of what follows it.
    assert page.get_attribute("body", "data-drawn") == str(len(runs[0]) - 2)
    assert page.locator(".uplot").count() == len(runs[0]) - 2
    picture = page.locator("section", has=page.get_by_role("heading", name="plant.theta"))
    assert picture.locator(".u-label").all_inner_texts()[1:] == ["source.r", "kp=300", "b <&"]
    border = "getComputedStyle(mark).borderTopStyle"
    borders = picture.locator(".u-marker").evaluate_all(f"marks => marks.map((mark) => {border})")
    assert {"solid", "dashed"} <= {*borders}, "the legend shows which run a curve is of"
    over = picture.locator(".u-over")
    over.hover(position={"x": 30, "y": 50})
    labels, shown = (picture.locator(f".u-{part}").all_inner_texts() for part in ("label", "value"))
    values = {name: value.replace("−", "-") for name, value in zip(labels, shown, strict=True)}
    row = np.flatnonzero(np.isclose(runs[0]["time"], float(values["time [s]"]), atol=1e-6))
    expected = runs[0]["plant.theta"][row[0]]
    assert float(values["kp=300"]) == pytest.approx(expected, rel=1e-6)
    # The other run ends in the middle.
    box = over.bounding_box()
    over.hover(position={"x": 0.8 * box["width"], "y": 50})
    assert picture.locator(".u-value").all_inner_texts()[-1] == "–"

    times, first, other = runs[1]["time"], *(run["plant.theta"] for run in runs)
    first = np.interp(times, runs[0]["time"], first)
    found = data(file)[1]["difference"]["columns"]
    [theta] = [column for column in found if column["name"] == "plant.theta"]
    largest = np.argmax(np.abs(first - other))
    assert theta["largest"] == pytest.approx((first - other)[largest], rel=0.01)
    assert theta["at"] == pytest.approx(times[largest], abs=0.002)
    assert f"at {theta['at']:.7g} s" in picture.inner_text()
    page.click("#difference")
    assert page.get_by_role("heading", name="Difference of plant.theta").count() == 1
    page.click("#by-unit")
    assert "[rad]" in page.locator("h2").all_inner_texts()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.context.close()


def test_a_run_is_drawn_over_others_with_other_start_values(program, fmus, tmp_path):
    page = tmp_path / "page.html"
    over = ("--over=controller.pid.kp=100", "--over=controller.pid.kp=1e3,plant.theta0=0.1")
    result = run("simulate", SYSTEM, "--stop=0.01", "--plot", page, *over)
    assert (result.returncode, result.stderr) == (0, "")
    runs = data(page)
    assert [shown["name"] for shown in runs] == [
        "kp=300, theta0=0",
        "kp=100",
        "kp=1000, theta0=0.1",
    ]
    first = [column(shown, "plant.theta")["values"][0] for shown in runs]
    assert first[:2] == [first[0]] * 2
    assert first[2] == pytest.approx(0.1, abs=1e-3)
    refused = run("simulate", SYSTEM, "--plot", page, "--over=controller.pid.kq=100")
    assert refused.returncode == 1
    assert "error: --over kq=100: " in refused.stderr
    refused = run("simulate", SYSTEM, "--plot", page, "--over", tmp_path / "none.csv")
    assert f"cannot read {tmp_path / 'none.csv'}" in refused.stderr


def test_the_page_tells_set_points_and_held_variables(drawn):
    shown = data(drawn[0])[0]
    found = {column["name"]: column["set_point"] for column in shown["columns"]}
    assert {name: of for name, of in found.items() if of} == {"plant.theta": "source.r"}
    held = {column["name"] for column in shown["columns"] if column["held"]}
    assert held == {"controller.u", "controller.u_p", "controller.e", "source.d"}


def test_a_page_of_many_rows_is_small_and_keeps_extremes(tmp_path):
    rows = 300_000
    times = np.arange(rows) / 1000
    wave = np.sin(times)
    wave[123_457] = 9
    saw = np.arange(rows) % 5
    table = np.column_stack([times, wave, saw, saw == 3])
    files = [tmp_path / name for name in ("a.csv", "b.csv")]
    for file, last in zip(files, (0, 0.25), strict=True):
        table[-1, 1] = last
        lines = (f"{t:.3f},{x:.9f},{n:.0f},{str(b == 1).lower()}\n" for t, x, n, b in table)
        file.write_text("time,wave [m],saw,is_three\n" + "".join(lines))
    page = tmp_path / "page.html"
    assert run("compare", *files, "--plot", page).returncode == 1
    assert page.stat().st_size < 2e6
    [_, first] = data(page)
    assert (first["rows"], first["interval"]) == (rows, 2 ** int(np.log2(first["interval"])))
    assert len(first["time"]) == 2 * -(-rows // first["interval"]) <= 2 * 4096
    interval = 123_457 // first["interval"]
    assert 9 in column(first, "wave")["values"][2 * interval : 2 * interval + 2]
    assert {*column(first, "saw")["values"]} == {0, 4}
    assert {*column(first, "is_three")["values"]} == {0, 1}
    [wave, saw] = first["difference"]["columns"]
    assert (wave["largest"], wave["at"]) == (0.25, pytest.approx(times[-1]))
    assert (saw["largest"], saw["values"]) == (0, [0])


def test_the_page_draws_any_values_and_names(browser: Browser, tmp_path):
    names = [
        "<script>alert(1)</script> [m]",
        "gap",
        "none",
        "huge",
        "tiny",
        "constant [K]",
        "on",
        "mode",
    ]
    rows = [
        ["0", "1", "1.5", "NaN", "1e300", "1e-300", "293.15", "true", "IDLE"],
        ["1", "2", "NaN", "inf", "-1e300", "3e-300", "293.15", "false", "a, long " + 60 * "b"],
        ["2", "3", "2.5", "NaN", "1e300", "2e-300", "293.15", "true", "IDLE"],
    ]
    file, page_file = tmp_path / "a.csv", tmp_path / "page.html"
    for count in (3, 1):
        lines = [["time", *names], *rows[:count]]
        file.write_text(
            "".join(
                ",".join(f'"{cell}"' if " " in cell else cell for cell in line) + "\n"
                for line in lines
            )
        )
        assert run("compare", file, file, "--plot", page_file).returncode == 0
        page = opened(browser, page_file, 390, "light")
        titles = page.locator("h2").all_inner_texts()
        assert titles == [
            "<script>alert(1)</script>",
            "gap",
            "huge",
            "tiny",
            "constant",
            "on",
            "mode",
        ]
        assert "none" in page.inner_text("#not-drawn")
        assert ("1 value" in page.inner_text("main")) == (count == 3)
        page.context.close()
    file.write_text("time\n0\n1\n")
    assert "the first has no variables" in run("compare", file, file, "--plot", page_file).stderr


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
    assert page.locator("h2").all_inner_texts() == [*texts, "a.count"]
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
    if parameters == 1:
        assert "controller.pid.kp = 400, at the upper edge" in page.inner_text("#hints")
    assert page.locator("#profiles .uplot").count() == (parameters if parameters > 1 else 0)
    page.select_option("#metric", "largest_u")
    assert page.locator("#best th").all_inner_texts()[:2] == ["run", "largest_u"]
    page.context.close()
