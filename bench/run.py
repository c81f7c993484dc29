"""Measure the speed of the FMUs and the native master, for docs/speed.md.

`make bench` measures; `make bench PUBLISH=1` also updates the page. Every comparison is a ratio of
measurements that alternate in one run on one machine. The results go to target/bench: results.json,
speed.md, and abilities.md with what the abilities of the master cost.
"""

import argparse
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import engines
from abilities import Abilities
from hosts import NATIVE
from measure import Bench
from page import EARLIER, earlier, last_before, published, render, render_abilities, worse
from pendulum_fmus.project import PROGRAM, ROOT

PAGE = ROOT / "docs" / "speed.md"


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description="Measure the FMUs and the native master.")
    kind = parser.add_mutually_exclusive_group()
    # fmt: off
    kind.add_argument("--quick", action="store_true",
        help="few rounds, with the program of `make fmus`, to check that everything works")
    kind.add_argument("--redraw", action="store_true", help="use the last measurements")
    parser.add_argument("--publish", type=Path, nargs="?", const=PAGE, metavar="PAGE",
        help="write the page, by default docs/speed.md")
    parser.add_argument("--out", type=Path, default=ROOT / "target" / "bench",
        help="folder of the results")
    # fmt: on
    options = parser.parse_args()
    if options.quick and options.publish == PAGE:
        parser.error("quick measurements are not for publication")
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    file = out / "results.json"
    if not options.redraw:
        with TemporaryDirectory(dir=out) as folder:
            results = Bench(Path(folder), quick=options.quick).measure()
            program = PROGRAM if options.quick else NATIVE
            abilities = Abilities(program, Path(folder), quick=options.quick)
            results["abilities"] = abilities.measure()
            results["wasm"] = engines.measure(Path(folder), quick=options.quick)
        file.write_text(json.dumps(results, indent=1), encoding="utf-8")
    results = json.loads(file.read_text(encoding="utf-8"))
    text, now = render(results), published(results)
    (out / "speed.md").write_text(text, encoding="utf-8")
    (out / "abilities.md").write_text(render_abilities(results["abilities"]), encoding="utf-8")
    print(*(line for line in text.splitlines() if line.startswith("|")), sep="\n")
    for line in worse(now, last_before(now)):
        print(f"worse than published: {line}", file=sys.stderr)
    if options.publish:
        options.publish.write_text(text, encoding="utf-8")
        if options.publish == PAGE and now != earlier()[-1]:
            with EARLIER.open("a", encoding="utf-8") as file:
                file.write(json.dumps(now) + "\n")


if __name__ == "__main__":
    main()
