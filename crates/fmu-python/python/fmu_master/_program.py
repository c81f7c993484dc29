"""The command line as a program, for which Python needs only `_native` beside this file.

`python -E -s -S _program.py simulate ...` imports no package, not even this one.
"""

import sys

import _native  # type: ignore[import-not-found]

_native.main([sys.executable, *sys.orig_argv[1:5]], ["cargo-fmu", *sys.argv[1:]])
