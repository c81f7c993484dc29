"""Link the module that cargo has built into the package, and the package into this environment."""

import sys
import sysconfig
from pathlib import Path

PACKAGE = Path(__file__).parent.resolve() / "python" / "fmu_master"
BUILT = Path(__file__).parents[2].resolve() / "target" / "debug"
PLATFORMS = {
    "darwin": ("lib_native.dylib", "_native.abi3.so"),
    "win32": ("_native.dll", "_native.pyd"),
}
"""The names of the library and of the module."""

library, module = PLATFORMS.get(sys.platform, ("lib_native.so", "_native.abi3.so"))
(PACKAGE / module).unlink(missing_ok=True)
(PACKAGE / module).symlink_to(BUILT / library)
Path(sysconfig.get_path("purelib"), "fmu-master.pth").write_text(f"{PACKAGE.parent}\n")
