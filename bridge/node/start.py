"""Entry point of a node's process, before slow imports.

python-can imports asammdf if it is installed, which takes half a second. Only writers of MF4 logs
need it, and a node does not write them.
"""

from __future__ import annotations

import os
import sys
from typing import Any, cast

cast(dict[str, Any], sys.modules).setdefault("asammdf", None)

from bridge.node.run import main  # noqa: E402
from cosim.base.python import add_working_directory  # noqa: E402

if __name__ == "__main__":
    add_working_directory()
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # all is written; threads of a library may hold a process at its end for seconds
