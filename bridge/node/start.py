"""Entry point of a node's process."""

from __future__ import annotations

import os
import sys

from bridge.node.run import main
from cosim.base.python import add_working_directory

if __name__ == "__main__":
    add_working_directory()
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # all is written; threads of a library may hold a process at its end for seconds
