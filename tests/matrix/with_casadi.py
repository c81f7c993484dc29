# /// script
# dependencies = ["casadi==3.8.2"]
# ///
"""CasADi."""

import tempfile
import zipfile

from casadi import DaeBuilder

from loop import FMUS

with tempfile.TemporaryDirectory() as folder:
    zipfile.ZipFile(FMUS["plant"]).extractall(folder)
    DaeBuilder("plant", folder)
