"""The documentation in every FMU: a self-contained page, licences and an icon."""

import re
import struct
import zipfile
from itertools import pairwise
from pathlib import PurePosixPath

import pytest
from lxml import etree, html
from playwright.sync_api import Browser

from native import read
from test_package import MODELS, Fmu, each_fmu, each_model, fmu, of

PAGE = "documentation/index.html"
SIZE_OF_DOCUMENTATION = 9_000
"""Maximum compressed size of page and icon, without the licences."""


__all__ = ["fmu"]  # a fixture


@pytest.fixture
def page(fmu: Fmu) -> etree._Element:
    """Return the page of a model, which is also well-formed XML with MathML and SVG."""
    return fmu.xml(PAGE)


def plain_name(element: etree._Element) -> str:
    """Return the name of an element without its namespace."""
    return etree.QName(element).localname


def texts(element: etree._Element, path: str) -> list[str]:
    """Return the texts of the elements at a path."""
    return ["".join(found.itertext()).strip() for found in element.iterfind(path)]


def test_every_model_has_its_own_small_icon(fmus):
    icons = [of(fmus, model).read("model.png") for model in MODELS]
    assert len(set(icons)) == len(MODELS)
    for icon in icons:
        assert icon.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">II", icon[16:24]) == (256, 256)
        assert b"tRNS" in icon, "the background is transparent"
        assert len(icon) < 4_000


@each_fmu
def test_the_page_parses_the_same_as_html_and_xml_and_is_small(fmu, page):
    # Elements that are self-closing in XML but not in HTML would swallow the following content.
    text = fmu.read(PAGE).decode()
    as_html = html.document_fromstring(text)
    names = ("h1", "h2", "h3", "p", "li", "td", "th")
    assert [e.tag for e in as_html.iter(*names)] == [e.tag for e in page.iter(*names)]
    assert texts(as_html, ".//td") == texts(page, ".//td")
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ufffd\ufffe\uffff]", text)
    assert "<!-- include" not in text
    icon = "terminalsAndIcons/icon.png" if fmu.is_fmi_3 else "model.png"
    with zipfile.ZipFile(fmu.path) as archive:
        sizes = [archive.getinfo(name).compress_size for name in (PAGE, icon)]
    assert sum(sizes) <= SIZE_OF_DOCUMENTATION


@each_fmu
def test_the_page_needs_nothing_but_files_of_the_fmu(fmu, page):
    identifiers = [e.get("id") for e in page.iter(etree.Element) if e.get("id")]
    assert len(identifiers) == len(set(identifiers))
    links = []
    for element in page.iter(etree.Element):
        assert plain_name(element) not in {"script", "iframe", "object", "embed", "link", "base"}
        for attribute, value in element.attrib.items():
            assert not attribute.startswith("on"), f"{attribute}={value}"
            if attribute in {"src", "href", "data", "srcset"}:
                links.append(value)
    assert "licenses/LICENSE-MIT" in links
    files = read(fmu.path)
    for link in links:
        if link.startswith("#"):
            assert link[1:] in identifiers
        else:
            path = PurePosixPath("documentation") / link
            assert str(path).replace("documentation/../", "") in files, link
    text = etree.tostring(page, encoding="unicode")
    assert {*re.findall(r"url\(#([^)]+)\)", text)} <= {*identifiers}
    assert "@import" not in text


@each_fmu
def test_the_page_has_all_sections_and_is_accessible(fmu, page):
    """`crates/fmu-build/src/page.rs` tests what a page takes from the model description."""
    assert texts(page, ".//h1") == [fmu.model]
    headings = texts(page, ".//h2")
    for heading in ("What it is", "Equations", "Result", "Coupling", "Limits", "Variables"):
        assert headings.count(heading) == 1
    assert len(page.findall(".//math")) >= 4
    assert len(page.findall(".//figure")) == 2
    assert page.get("lang") == "en"
    assert page.find("head/title").text
    levels = [int(e.tag[1]) for e in page.iter("h1", "h2", "h3", "h4")]
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
    pictures = [e for e in page.iter(etree.Element) if plain_name(e) == "svg"]
    assert [picture.get("role") for picture in pictures] == ["img", "img"]
    assert all(len(picture.get("aria-label")) > 40 for picture in pictures)
    assert all("alt" in image.attrib for image in page.iter("img"))
    assert all(cell.get("scope") in {"col", "row"} for cell in page.iter("th"))


@each_model
def test_names_in_the_text_are_variables_or_models(fmus, model):
    known = {v.name for name in MODELS for v in of(fmus, name).description.modelVariables}
    known |= {name.split("[")[0] for name in known}
    known |= {*MODELS, f"{model}.fmu", "own", "supervisor", "step", "sine", "square"}
    known |= {"linear", "nonlinear", "transfer_function"}
    assert {*texts(of(fmus, model).xml(PAGE), ".//code")} <= known


def test_a_phone_scrolls_tables_but_not_the_page_and_shows_dots(fmus, browser: Browser):
    phone = browser.new_context(viewport={"width": 390, "height": 900})
    page = phone.new_page()
    for model in reversed(MODELS):
        page.set_content(of(fmus, model).read(PAGE).decode())
        assert page.evaluate("document.documentElement.scrollWidth") == 390, model
    # The last page, of the plant, has derivatives.
    accents = page.evaluate(
        """[...document.querySelectorAll("mover")].map((mover) => {
        const [letter, dots] = [...mover.children].map((part) => part.getBoundingClientRect());
        return [mover.textContent, letter.top - dots.bottom];
    })"""
    )
    assert {text for text, _ in accents} == {"x˙", "x¨", "θ˙", "θ¨"}
    assert all(gap > 1 for _, gap in accents), "letters and dots touch"
    phone.close()
