"""The report's page in a real browser: its figures, and the absence of network requests."""

import json
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from pendulum_fmus.loop import Loop

FLAGS = """--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
--disable-component-update --disable-sync""".split()

DRAWN = "body[data-drawn]"
"""Present once all figures are drawn."""


@pytest.fixture(scope="module")
def chromium() -> str:
    """Return the path of Chromium."""
    return shutil.which("chromium") or pytest.skip("no `chromium`: `make system` installs it")


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        # Playwright uses a new, empty profile
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser
        browser.close()


TITLES = ".infolayer > [class^='g-x'] text, .infolayer > [class^='g-y'] text"
"""Selector of the titles of all axes."""


class Opened:
    """The opened page with its console messages and requests."""

    def __init__(self, page: Page, folder: Path):
        self.page = page
        self.said: list[str] = []
        self.asked: list[str] = []
        page.on("console", lambda message: self.said.append(message.text))
        page.on("pageerror", lambda error: self.said.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))
        self.url = (folder / "index.html").as_uri()
        page.goto(self.url)
        page.wait_for_selector(DRAWN, state="attached", timeout=120_000)


@pytest.fixture(scope="module", params=["desktop", "phone", "dark"])
def opened(request, browser: Browser, report_folder: Path) -> Iterator[Opened]:
    width = 390 if request.param == "phone" else 1400
    scheme = "dark" if request.param == "dark" else "light"
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    yield Opened(context.new_page(), report_folder)
    context.close()


def plots(page: Page) -> list[dict]:
    """Return the drawn elements and the data of every plot."""
    return page.evaluate(
        """() => [...document.querySelectorAll(".plot")].map((plot) => ({
        name: plot.id,
        paths: [...plot.querySelectorAll(".scatterlayer path.js-line")]
            .map((path) => path.getAttribute("d").length),
        axes: [...plot.querySelectorAll("%s")].map((title) => title.textContent),
        panels: plot.querySelectorAll(".cartesianlayer .subplot").length,
        legend: [...plot.querySelectorAll(".legendtext")].map((text) => text.textContent),
        traces: plot.data.filter((trace) => trace.mode === "lines" && trace.x[0] !== null).length,
        width: plot.querySelector("svg").getBoundingClientRect().width,
        room: plot.getBoundingClientRect().width,
    }))""".replace("%s", TITLES)
    )


def test_there_are_no_errors_and_no_requests(opened):
    assert opened.said == []
    assert opened.asked == [opened.url]


def test_every_figure_is_drawn(opened):
    found = plots(opened.page)
    assert len(found) == int(opened.page.get_attribute("body", "data-drawn")) >= 19
    for plot in found:
        assert plot["traces"] > 0, plot
        assert len([length for length in plot["paths"] if length > 10]) >= plot["traces"], plot
        assert plot["width"] <= plot["room"] + 1, plot


def test_every_axis_has_a_title_with_its_unit_and_every_figure_a_legend(opened):
    for plot in plots(opened.page):
        assert len(plot["axes"]) == 2 * plot["panels"], plot
        assert all("[" in title and title.endswith("]") for title in plot["axes"]), plot
        assert len(plot["legend"]) >= 2, plot


def test_the_page_is_no_wider_than_the_window(opened):
    wide, window = opened.page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    )
    assert wide <= window


def test_labels_of_axes_do_not_overlap(opened):
    overlaps = opened.page.evaluate(
        """() => {
        const cross = (a, b) =>
            a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
        return [...document.querySelectorAll(".plot")].filter((plot) => {
            const labels = plot.querySelectorAll(
                ".xtick text, .ytick text, .legendtext, .annotation-text, %s");
            const boxes = [...labels].map((label) => label.getBoundingClientRect());
            return boxes.some((a, i) => boxes.slice(i + 1).some((b) => cross(a, b)));
        }).map((plot) => plot.id);
    }""".replace("%s", TITLES)
    )
    assert overlaps == []


def test_headings_do_not_skip_a_level(opened):
    levels = opened.page.evaluate(
        "[...document.querySelectorAll('h1, h2, h3, h4')].map((h) => Number(h.tagName[1]))"
    )
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_hovering_shows_numbers_as_computed(browser, report_folder, table_results):
    """The drawn points equal samples to the last bit."""
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    opened = Opened(context.new_page(), report_folder)
    drawn = json.loads(
        opened.page.evaluate("""() => {
            const plot = document.getElementById("plot-figure-6");
            const lines = plot.data.filter((t) => t.mode === "lines" && t.x[0] !== null);
            const trace = lines.find((t) => t.name === "PID");
            return JSON.stringify({x: [...trace.x], y: [...trace.y]});
        }""")
    )
    context.close()
    run = table_results[Loop("Pid", "step", 0.0)]
    exact = dict(zip(run["time"].tolist(), run["plant.theta"].tolist(), strict=True))
    assert len(drawn["x"]) > 100
    assert all(exact[x] == y for x, y in zip(drawn["x"], drawn["y"], strict=True))
    assert max(drawn["y"]) == run["plant.theta"].max()


def test_prints_to_pages(browser, report_folder):
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    opened = Opened(context.new_page(), report_folder)
    pdf = opened.page.pdf(prefer_css_page_size=True)
    context.close()
    assert pdf.startswith(b"%PDF-")
    assert opened.said == []
