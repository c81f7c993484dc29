"""Write the page that runs the FMUs: one file, with the FMUs of target/wasm in it."""

import argparse
import base64
import json
import tomllib
from html import escape
from pathlib import Path
from urllib.parse import quote, urlsplit

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["Pendulum", "Pid", "PidRbf", "IpidRbf"]

TITLE = "A pendulum, balanced by FMUs"
DESCRIPTION = (
    "Push the cart, and see how a PID controller balances the pendulum, alone and with a neural "
    "network that learns as it runs. The FMUs run in the browser."
)
PICTURE = "preview.png"  # which `make picture` records
ICON = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><path d="M8 11 12 1"
stroke="#e0622b" stroke-width="2" stroke-linecap="round"/><path d="M3 10h10v4H3z" fill="#2a78d6"/>
</svg>"""


def address(text: str) -> str:
    """Return the address of a folder on the web, with a slash at its end."""
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or not parts.netloc or parts.query or parts.fragment:
        message = f"{text!r}: expected the address of the page, such as https://example.org/page/"
        raise argparse.ArgumentTypeError(message)
    return text.rstrip("/") + "/"


def preview(url: str | None) -> str:
    """Return the elements of a link preview that need the address of the page."""
    if not url:
        return '<meta name="twitter:card" content="summary">'
    url, picture = escape(url), escape(url + PICTURE)
    return f"""<link rel="canonical" href="{url}">
<meta property="og:url" content="{url}">
<meta property="og:image" content="{picture}">
<meta property="og:image:width" content="1200">
<meta property="og:image:height" content="630">
<meta property="og:image:alt" content="Two carts with pendulums after a push, and their angles">
<meta name="twitter:card" content="summary_large_image">"""


def write(file: Path, content: bytes) -> None:
    """Write a file, whole or not at all."""
    partial = file.with_name(f"{file.name}.partial")
    partial.write_bytes(content)
    partial.replace(file)


def main() -> None:
    """Write index.html to target/page, and with an address the picture of its link preview."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", type=address, help="address where the page will be published")
    parser.add_argument("--out", type=Path, default=ROOT / "target" / "page", metavar="FOLDER")
    options = parser.parse_args()
    web = ROOT / "web"
    read = {name: (ROOT / "target" / "wasm" / f"{name}_fmi3.fmu").read_bytes() for name in NAMES}
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    repository = manifest["workspace"]["package"]["repository"]
    link = f'<a href="{repository}">the repository</a>' if repository else "the repository"
    parts = {
        "title": TITLE,
        "description": escape(DESCRIPTION),
        "preview": preview(options.url),
        "icon": quote(ICON.replace("\n", " ")),
        "repository": link,
        **{file.name: file.read_text(encoding="utf-8") for file in web.glob("*.js")},
        "fmus": json.dumps({name: base64.b64encode(it).decode() for name, it in read.items()}),
    }
    page = (web / "page.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace(f"{{{{{name}}}}}", text)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.url:
        write(options.out / PICTURE, (web / PICTURE).read_bytes())
    write(options.out / "index.html", page.encode())
    print(f"{options.out / 'index.html'}  {len(page) // 1024} KB")


if __name__ == "__main__":
    main()
