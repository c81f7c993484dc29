"""Write the page that runs the FMUs: one file, with the FMUs of target/wasm in it."""

import base64
import json
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NAMES = ["Pendulum", "Pid", "PidRbf", "IpidRbf"]


def main() -> None:
    """Write target/page/index.html."""
    web, folder = ROOT / "web", ROOT / "target" / "page"
    read = {name: (ROOT / "target" / "wasm" / f"{name}_fmi3.fmu").read_bytes() for name in NAMES}
    fmus = json.dumps({name: base64.b64encode(content).decode() for name, content in read.items()})
    page = (web / "page.html").read_text(encoding="utf-8")
    for name in ("fmu.js", "page.js"):
        page = page.replace(f"{{{{{name}}}}}", (web / name).read_text(encoding="utf-8"))
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    repository = manifest["workspace"]["package"]["repository"]
    link = f'<a href="{repository}">the repository</a>' if repository else "the repository"
    page = page.replace("{{repository}}", link)
    page = page.replace("{{fmus}}", fmus)
    folder.mkdir(parents=True, exist_ok=True)
    partial = folder / "index.html.partial"
    partial.write_text(page, encoding="utf-8")
    partial.replace(folder / "index.html")
    print(f"{folder / 'index.html'}  {len(page) // 1024} KB")


if __name__ == "__main__":
    main()
