"""Write the numbers of ``paper.md`` anew: ``python docs/evidence/paper_numbers.py``.

A number in the text has its name behind it, ``238<!-- claims -->``. Each is counted or computed
here in a second; the speed is that of ``benchmarks/README.md``, which names machine and date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "paper.md"
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import cosim  # noqa: E402
from docs.evidence.compatibility import TESTED  # noqa: E402
from fmus.build.archive import shipped_models  # noqa: E402
from fmus.paper.reproduction import listing  # noqa: E402

NUMBER = re.compile(r"[\d.]+(?=<!-- (\w+) -->)")


def numbers() -> dict[str, str]:
    """Every number of the text by its name."""
    metrics = cosim.run(ROOT / "configs" / "teleoperation.toml").metrics
    page = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    speed = re.search(r"take (\d+) ms \((\d+) times real time", page)
    if speed is None:
        raise ValueError("benchmarks/README.md: found no time of 60 s of teleoperation")
    return {
        "claims": str(len(listing())),
        "models": str(len(shipped_models())),
        "tools": str(len({one.tool for one in TESTED})),
        "settle": f"{metrics['sync_error'].parts['settle_s']:.2f}",
        "effort": f"{metrics['effort'].value:.2f}",
        "wall": speed[1],
        "ratio": speed[2],
    }


def written(text: str, found: Mapping[str, str]) -> str:
    """A text with the numbers found. Raises KeyError for a name that is none of them."""
    return NUMBER.sub(lambda match: found[match[1]], text)


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(written(text, numbers()), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
