"""What `web/build.py` writes for link previews of the page."""

import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from pendulum_fmus.project import ROOT


class Head(HTMLParser):
    """The elements of a page that link previews read."""

    def __init__(self, file: Path) -> None:
        """Read a page."""
        super().__init__()
        self.meta: dict[str | None, str | None] = {}
        self.links: dict[str | None, str | None] = {}
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take an element."""
        given = dict(attrs)
        if tag == "meta":
            self.meta[given.get("property", given.get("name"))] = given.get("content")
        if tag == "link":
            self.links[given["rel"]] = given["href"]


def build(out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Write the page to a folder."""
    command = [sys.executable, ROOT / "web/build.py", "--out", out, *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_link_preview_has_a_picture_when_the_address_is_known(components, tmp_path):
    assert build(tmp_path / "with", "--url", "https://example.org/a&b").returncode == 0
    head = Head(tmp_path / "with" / "index.html")
    assert head.meta["og:url"] == head.links["canonical"] == "https://example.org/a&b/"
    assert head.meta["og:image"] == "https://example.org/a&b/preview.png"
    assert head.meta["twitter:card"] == "summary_large_image"
    with Image.open(tmp_path / "with" / "preview.png") as picture:
        size = (head.meta["og:image:width"], head.meta["og:image:height"])
        assert tuple(map(str, picture.size)) == size
    assert build(tmp_path / "without").returncode == 0
    assert [file.name for file in (tmp_path / "without").iterdir()] == ["index.html"]
    head = Head(tmp_path / "without" / "index.html")
    assert head.meta["twitter:card"] == "summary"
    assert head.meta["og:title"]
    assert 50 < len(head.meta["og:description"] or "") < 200
    assert {"og:url", "og:image"}.isdisjoint(head.meta)
    assert "{{" not in (tmp_path / "without" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "url", ["example.org", "ftp://example.org", "https://", "https://e.org/?a"]
)
def test_an_address_that_is_none_is_refused(tmp_path, url):
    done = build(tmp_path / "page", "--url", url)
    assert done.returncode == 2
    assert f"{url!r}: expected the address of the page, such as https://" in done.stderr
    assert not (tmp_path / "page").exists()
