"""Entry point of a node's process, before anything heavy is imported.

python-can imports asammdf wherever that is installed, half a second that only who writes MF4 logs
needs; a node does not.
"""

from __future__ import annotations

import sys
from typing import Any, cast

cast(dict[str, Any], sys.modules).setdefault("asammdf", None)

from bridge.node import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
