"""Runs FMUs with components in Node by web/fmu.js, with descriptions that FMPy has read."""

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from fmpy import read_model_description

from pendulum_fmus.project import ROOT

SCRIPT = """
const fs = require("fs");
const { files, descriptions, given } = JSON.parse(fs.readFileSync(0, "utf-8"));
(async () => {
  const fmus = {};
  for (const name in files) {
    fmus[name] = await readFmu(fs.readFileSync(files[name]), () => descriptions[name]);
  }
  process.stdout.write(JSON.stringify(answer(fmus, given)));
})();
"""


@cache
def program() -> str | None:
    """Return Node, beside Python or on the PATH, if it can decompress FMUs, as 20.12 and newer."""
    for path in (str(Path(sys.executable).parent), None):
        if found := shutil.which("node", path=path):
            command = [found, "--eval", "new DecompressionStream('deflate-raw')"]
            if subprocess.run(command, capture_output=True, check=False).returncode == 0:
                return found
    return None


def in_node(files: Mapping[str, Path], script: str, given: object) -> Any:
    """Return what the function `answer` of a script returns for these FMUs and what is given."""
    descriptions = {}
    for name, file in files.items():
        d = read_model_description(file)
        variables = {v.name: {"reference": v.valueReference} for v in d.modelVariables}
        id_ = d.coSimulation.modelIdentifier
        descriptions[name] = {"name": name, "id": id_, "token": d.guid, "variables": variables}
    paths = {name: str(file) for name, file in files.items()}
    text = json.dumps({"files": paths, "descriptions": descriptions, "given": given})
    code = (ROOT / "web" / "fmu.js").read_text(encoding="utf-8") + script + SCRIPT
    command = [program(), "--eval", code]
    done = subprocess.run(command, input=text, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout)
