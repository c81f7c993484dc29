"""The report's page in a real browser: its figures, and the absence of network requests."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from pendulum_fmus.loop import Loop
from pendulum_fmus.project import ROOT

DRAWN = "body[data-drawn]"
"""Present once the figures that are not folded are drawn."""

WIDTHS = [390, 768, 1024, 1400, 1600]
"""Widths of windows: a phone, tablets and desktops."""

MOST = 3_000_000
"""The page's largest size [B]."""


PROBES = ROOT / "tests" / "data" / "report.js"
"""Functions that measure the page."""


class Opened:
    """The opened page with its console messages and requests; later, all of it is unfolded."""

    def __init__(self, page: Page, folder: Path):
        self.page = page
        self.said: list[str] = []
        self.asked: list[str] = []
        page.add_init_script(path=PROBES)
        page.on("console", lambda message: self.said.append(message.text))
        page.on("pageerror", lambda error: self.said.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))
        self.url = (folder / "index.html").as_uri()
        page.goto(self.url)
        page.wait_for_selector(DRAWN, state="attached", timeout=120_000)
        self.height = page.evaluate("document.documentElement.scrollHeight")
        self.first = page.evaluate("document.querySelector('.drawing').getBoundingClientRect().top")
        page.evaluate("document.querySelectorAll('main details').forEach((d) => (d.open = true))")

    def resize(self, width: int) -> None:
        """Give the window a width; return when all panels fit it."""
        self.page.set_viewport_size({"width": width, "height": 900})
        self.page.wait_for_function("panelsFit()")


@pytest.fixture(scope="module")
def opened(browser: Browser, report_folder: Path) -> Iterator[Opened]:
    context = browser.new_context(viewport={"width": 1400, "height": 900}, color_scheme="light")
    yield Opened(context.new_page(), report_folder)
    context.close()


@pytest.fixture(params=WIDTHS)
def resized(request, opened: Opened) -> Page:
    """Return the page in a window of each width."""
    opened.resize(request.param)
    return opened.page


@pytest.fixture
def wide(opened: Opened) -> Page:
    """Return the page in a wide window."""
    opened.resize(1400)
    return opened.page


def test_is_small_and_has_no_errors_and_no_requests(opened, report_folder):
    assert (report_folder / "index.html").stat().st_size < MOST
    assert opened.said == []
    assert opened.asked == [opened.url]


def test_shows_the_curves_at_once_and_folds_the_rest(opened):
    assert opened.first < 2 * 900
    assert opened.height < 16 * 900


def test_draws_every_curve_of_every_panel_in_both_schemes(wide):
    figures = wide.locator("figure .plot").count()
    panels = wide.locator(".drawing").count()
    assert figures > 19
    assert panels == int(wide.get_attribute("body", "data-drawn"))
    for scheme in ("dark", "light"):
        wide.emulate_media(color_scheme=scheme)
        wide.wait_for_timeout(2000)
        drawn = wide.evaluate("colours")
        assert len(drawn) > 2 * figures
        assert all(any(panel) for panel in drawn)
        # Curves can hide behind each other or lie off the scale of a panel
        assert sum(map(sum, drawn)) > 0.9 * sum(map(len, drawn))


def test_every_axis_has_a_title_with_its_unit_and_every_figure_a_legend(wide):
    titles = wide.locator(".x-title, .y-title").all_text_contents()
    assert len(titles) == 2 * wide.locator(".drawing").count()
    assert all("[" in title and title.endswith("]") for title in titles)
    for plots in wide.locator(".plot").all():
        assert plots.locator(".legend li").count() >= 2


def test_nothing_is_wider_than_its_container(resized):
    assert resized.evaluate("cut") == []


def test_text_in_the_diagram_is_legible(resized):
    assert resized.evaluate("smallestText") >= 11


def test_labels_of_axes_are_readable_and_do_not_overlap(resized):
    axes = resized.evaluate("labels")
    assert any(axis["log"] for axis in axes)
    for axis in axes:
        assert len(axis["texts"]) >= 2, axis
        spans = sorted(axis["spans"])
        assert all(a[1] < b[0] for a, b in pairwise(spans)), axis
        powers = axis["log"] and axis["decades"] > 2.2
        wanted = r"10⁻?[⁰¹²³⁴⁵⁶⁷⁸⁹]+" if powers else r"−?\d+(\.\d+)?"
        assert all(re.fullmatch(wanted, text) for text in axis["texts"]), axis


def test_contents_follow_the_section(wide):
    wide.add_style_tag(content="html { scroll-behavior: auto !important; }")
    for name in ("table-1", "beyond-noise", "statements", "summary"):
        wide.locator(f".contents a[href='#{name}']").click()
        wide.wait_for_selector(f".contents a[href='#{name}'][aria-current]")
        assert wide.locator(".contents [aria-current]").count() == 1


def test_contents_of_a_phone_fold_away_and_cover_no_heading(opened):
    opened.resize(390)
    page = opened.page
    page.locator(".contents summary").click()
    page.locator(".contents a[href='#beyond-noise']").click()
    page.wait_for_selector(".contents a[href='#beyond-noise'][aria-current]", state="attached")
    assert page.locator(".contents details[open]").count() == 0
    assert "noise" in page.locator(".contents .here").text_content().lower()
    bar = page.locator(".contents").bounding_box()
    heading = page.locator("#beyond-noise h3").bounding_box()
    assert bar["y"] == 0
    assert bar["height"] <= heading["y"] < 200


def test_headings_do_not_skip_a_level(wide):
    levels = wide.evaluate("levels")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_hovering_shows_numbers_as_computed(wide, table_results):
    """The drawn points equal samples to the last bit, and the readout shows one of them."""
    drawing = wide.locator("#plot-figure-6 .drawing").first
    drawn = drawing.evaluate("peak")
    run = table_results[Loop("Pid", "step", 0.0)]
    exact = dict(zip(run["time"].tolist(), run["plant.theta"].tolist(), strict=True))
    assert len(drawn["x"]) > 100
    assert all(exact[x] == y for x, y in zip(drawn["x"], drawn["y"], strict=True))
    assert max(drawn["y"]) == run["plant.theta"].max()

    drawing.locator(".u-over").hover(position=drawn["at"])
    shown = drawing.locator(".readout").text_content().splitlines()
    assert shown[0] == "PID"
    assert exact[float(shown[1].split(" = ")[1])] == float(shown[2].split(" = ")[1])


def test_dragging_zooms_and_double_clicks_go_back_and_show_everything(wide):
    drawing = wide.locator("#plot-figure-6 .drawing").first
    drawing.scroll_into_view_if_needed()
    whole, box = drawing.evaluate("ranges"), drawing.locator(".u-over").bounding_box()
    x, y, width, height = (box[key] for key in ("x", "y", "width", "height"))
    wide.mouse.move(x + width / 4, y + height / 4)
    wide.mouse.down()
    wide.mouse.move(x + width / 2, y + height / 2, steps=3)
    wide.mouse.up()
    expected = [whole[0] + (whole[1] - whole[0]) * share for share in (0.25, 0.5)]
    assert drawing.evaluate("ranges")[:2] == pytest.approx(expected, abs=0.2)
    wide.mouse.dblclick(x + width / 2, y + height / 2)
    assert drawing.evaluate("ranges") == whole
    wide.mouse.dblclick(x + width / 2, y + height / 2)
    assert drawing.evaluate("ranges") == drawing.evaluate("extent")


def test_a_link_unfolds_its_target(browser, report_folder):
    page = browser.new_page()
    page.goto((report_folder / "index.html").as_uri() + "#figure-9")
    page.wait_for_selector("#figure-9[open] .u-over")
    assert page.locator("#figure-6[open]").count() == 0
    page.close()


def test_shows_images_without_scripts(browser, report_folder):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((report_folder / "index.html").as_uri())
    assert page.locator("figure img:visible").count() >= 1
    for part in page.locator("#figures details").all():
        part.locator("summary").click()
    shown = page.locator("figure img:visible").count()
    blank = page.locator(".plot:visible").count()
    context.close()
    assert shown >= 19
    assert blank == 0
