"""The documentation in every FMU: a self-contained page, licences and an icon."""

import io
import math
import re
import struct
import zipfile
from collections.abc import Iterator
from itertools import groupby, pairwise
from pathlib import Path, PurePosixPath

import fmpy
import numpy as np
import pytest
from lxml import etree, html
from PIL import Image
from playwright.sync_api import Browser, Page

MODELS = ["Pendulum", "Pid", "PidRbf", "IpidRbf", "Source"]
PAGE = "documentation/index.html"
SIZE_OF_DOCUMENTATION = 9_000
"""Maximum compressed size of page and icon, without the licences."""

each_model = pytest.mark.parametrize("model", MODELS)


def content(fmus: Path, model: str, name: str) -> bytes:
    """Return a file of an FMU."""
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        return archive.read(name)


def names(fmus: Path, model: str) -> list[str]:
    """Return the paths of an FMU's files."""
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        return archive.namelist()


@pytest.fixture
def page(fmus: Path, model: str) -> etree._Element:
    """Return the page of a model, which is also well-formed XML with MathML and SVG."""
    return etree.fromstring(content(fmus, model, PAGE))


def plain_name(element: etree._Element) -> str:
    """Return the name of an element without its namespace."""
    return etree.QName(element).localname


def texts(element: etree._Element, path: str) -> list[str]:
    """Return the texts of the elements at a path."""
    return ["".join(found.itertext()).strip() for found in element.iterfind(path)]


@each_model
def test_page_licences_and_icon_exist_and_are_small(fmus, model):
    files = names(fmus, model)
    assert PAGE in files
    assert {"documentation/licenses/LICENSE-MIT", "documentation/licenses/LICENSE-APACHE"} <= {
        *files
    }
    assert "model.png" in files
    # All other files in the folder of the model are part of the page.
    beside = [f for f in files if f.startswith("documentation/") and "/licenses/" not in f]
    assert beside == [PAGE]
    with zipfile.ZipFile(fmus / f"{model}.fmu") as archive:
        sizes = [archive.getinfo(name).compress_size for name in (PAGE, "model.png")]
    assert sum(sizes) <= SIZE_OF_DOCUMENTATION


def test_every_model_has_its_own_icon(fmus):
    icons = [content(fmus, model, "model.png") for model in MODELS]
    assert len(set(icons)) == len(MODELS)
    for icon in icons:
        assert icon.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">II", icon[16:24]) == (256, 256)
        assert b"tRNS" in icon, "the background is transparent"
        assert len(icon) < 4_000


@each_model
def test_the_page_parses_the_same_as_html_and_xml(fmus, model, page):
    # Elements that are self-closing in XML but not in HTML would swallow the following content.
    as_html = html.document_fromstring(content(fmus, model, PAGE).decode())
    assert [e.tag for e in as_html.iter("h1", "h2", "h3", "p", "li", "td", "th")] == [
        e.tag for e in page.iter("h1", "h2", "h3", "p", "li", "td", "th")
    ]
    assert texts(as_html, ".//td") == texts(page, ".//td")
    text = content(fmus, model, PAGE).decode()
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ufffd\ufffe\uffff]", text)
    assert "<!-- include" not in text


@each_model
def test_page_needs_no_network_and_no_script(page, fmus, model):
    for element in page.iter(etree.Element):
        assert plain_name(element) not in {"script", "iframe", "object", "embed", "link", "base"}
        for attribute, value in element.attrib.items():
            assert not attribute.startswith("on"), f"{attribute}={value}"
            if attribute in {"src", "href", "data", "srcset"}:
                assert "://" not in value, value
    assert b"@import" not in content(fmus, model, PAGE)


@each_model
def test_links_point_to_files_of_the_fmu(page, fmus, model):
    files = names(fmus, model)
    identifiers = [e.get("id") for e in page.iter(etree.Element) if e.get("id")]
    assert len(identifiers) == len(set(identifiers))
    links = [e.get("href") or e.get("src") for e in page.iter("a", "img")]
    assert "licenses/LICENSE-MIT" in links
    for link in links:
        if link.startswith("#"):
            assert link[1:] in identifiers
        else:
            path = PurePosixPath("documentation") / link
            assert str(path).replace("documentation/../", "") in files, link
    used = re.findall(r"url\(#([^)]+)\)", etree.tostring(page, encoding="unicode"))
    assert {*used} <= {*identifiers}


def rows(page: etree._Element) -> dict[str, list[str]]:
    """Return the cells of the table of variables, by name."""
    body = page.find(".//table[@id='variables']/tbody")
    assert body is not None
    return {row[0].text: ["".join(cell.itertext()) for cell in row[1:]] for row in body}


@each_model
def test_the_table_matches_the_variables_of_the_xml(page, fmus, model):
    table = rows(page)
    variables = fmpy.read_model_description(fmus / f"{model}.fmu").modelVariables
    assert list(table) == [v.name for v in variables]
    for variable in variables:
        causality, variability, kind, unit, start, bounds, about = table[variable.name]
        assert causality == variable.causality
        assert variability == variable.variability
        assert kind == variable.type
        assert unit == (variable.unit or "")
        assert about == variable.description
        if kind == "Enumeration":
            (item,) = [i for i in variable.declaredType.items if i.value == variable.start]
            assert start == item.name
        else:
            assert start == (variable.start or "")
        if variable.min is not None and variable.max is not None:
            expected = [float(variable.min), float(variable.max)]
            assert [float(bound) for bound in bounds.split(" to ")] == expected


@each_model
def test_page_has_the_identity_of_the_fmu_and_all_sections(page, fmus, model):
    description = fmpy.read_model_description(fmus / f"{model}.fmu")
    text = "".join(page.itertext())
    assert texts(page, ".//h1") == [model]
    for expected in (description.description, description.guid, description.version):
        assert expected in text
    headings = texts(page, ".//h2")
    for heading in ("What it is", "Equations", "Result", "Coupling", "Limits", "Variables"):
        assert headings.count(heading) == 1
    assert len(page.findall(".//math")) >= 4
    assert len(page.findall(".//figure")) == 2


@each_model
def test_page_is_accessible(page, model):
    assert page.get("lang") == "en"
    assert page.find("head/title").text
    levels = [int(e.tag[1]) for e in page.iter("h1", "h2", "h3", "h4")]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    pictures = [e for e in page.iter(etree.Element) if plain_name(e) == "svg"]
    assert len(pictures) == 2
    for picture in pictures:
        assert picture.get("role") == "img"
        assert len(picture.get("aria-label")) > 40
    assert all("alt" in image.attrib for image in page.iter("img"))
    assert all(cell.get("scope") in {"col", "row"} for cell in page.iter("th"))


@each_model
def test_names_in_the_text_are_variables_or_models(page, fmus, model):
    known = {v.name for name in MODELS
             for v in fmpy.read_model_description(fmus / f"{name}.fmu").modelVariables}  # fmt: skip
    known |= {name.split("[")[0] for name in known}
    known |= {*MODELS, f"{model}.fmu", "own", "supervisor", "step", "sine", "square",
              "linear", "nonlinear", "transfer_function"}  # fmt: skip
    assert {*texts(page, ".//code")} <= known


@pytest.fixture(params=["light", "dark"])
def phone(request, browser: Browser) -> Iterator[Page]:
    """Return a page of a browser, in the narrowest usual width and at the lowest resolution."""
    context = browser.new_context(viewport={"width": 390, "height": 900},
                                  color_scheme=request.param)  # fmt: skip
    yield context.new_page()
    context.close()


@each_model
def test_a_phone_scrolls_tables_and_pictures_but_not_the_page(phone, fmus, model):
    phone.set_content(content(fmus, model, PAGE).decode())
    assert phone.evaluate("document.documentElement.scrollWidth") == 390


def test_the_dots_of_derivatives_can_be_counted(phone, fmus):
    phone.set_content(content(fmus, "Pendulum", PAGE).decode())
    accents = phone.evaluate(
        """[...document.querySelectorAll("mover")].map((mover) => {
        const [letter, dots] = [...mover.children].map((part) => part.getBoundingClientRect());
        return [dots.left, dots.top, dots.right, dots.bottom, letter.top, mover.textContent];
    })"""
    )
    picture = Image.open(io.BytesIO(phone.screenshot(full_page=True))).convert("L")
    pixels = np.asarray(picture, dtype=float)
    contrast = np.abs(pixels - pixels[0, 0]) / np.ptp(pixels)
    assert {text for *_, text in accents} == {"x˙", "x¨", "θ˙", "θ¨"}
    for left, top, right, bottom, letter, text in accents:
        assert bottom + 1 < letter, f"{text} touch"
        drawn = contrast[
            math.floor(top) : math.ceil(bottom), math.floor(left) : math.ceil(right)
        ].max(axis=0)
        dots = [dark for dark, _ in groupby(drawn > 0.6) if dark]
        assert len(dots) == {"˙": 1, "¨": 2}[text[-1]], f"{text}: {drawn.round(2)}"
