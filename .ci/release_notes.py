"""Print what the changelog says of a release, or why it cannot be made: `release_notes.py v1.2.3`.

Run it in the root of the project.
"""

import re
import sys
import tomllib
from pathlib import Path


def main() -> None:
    """Check that tag, workspace and changelog name the same version, and print its section."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    tag = sys.argv[1]
    version = tomllib.loads(Path("Cargo.toml").read_text())["workspace"]["package"]["version"]
    if tag != f"v{version}":
        sys.exit(f"error: the tag is {tag}, expected v{version}, as Cargo.toml has it")
    section = re.search(
        rf"^## {re.escape(version)}(?: [^\n]*)?\n(.*?)(?=^## |\Z)",
        Path("CHANGELOG.md").read_text(),
        re.MULTILINE | re.DOTALL,
    )
    if not section or not section[1].strip():
        sys.exit(f"error: CHANGELOG.md has nothing under `## {version}`")
    print(section[1].strip())


if __name__ == "__main__":
    main()
