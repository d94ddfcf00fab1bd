"""Commands of all pages that need nothing but the project end as they should."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.test_page_code import PAGES, ROOT, commands

pytestmark = [pytest.mark.slow, pytest.mark.site]

#: What keeps a command from being run here: it needs files of the reader, an interface or another
#: host, it never ends by itself, or it takes more than some minutes.
_ELSEWHERE = re.compile(
    r"can0|vcan|socketcan|udp_multicast|192\.0\.2|robot\.local|\bRUN\b|runs/|plant\.fmu|scene\.xml|"
    r"arm\.fmu|\barm\.toml|mine\.toml|\bmy_|\.log\b|^(node|pong|tell|monitor|campaign|soak|completion)\b|"
    r"^ping|--deploy (zenoh|mixed|gateway|network|can$)|^reproduce$|^rehearse \S+$|lambda_M_K|"
    r"benchmark\.toml|--controllers|^bus |^keys|bench\b|^doctor --deploy|/tmp/"
)
#: These pages have tests of their own.
_TESTED = ("docs/tutorial.md", "docs/zh/tutorial.md", "docs/your-own-arm.md")
#: What a page shows that `check` finds to be wrong.
_FINDS = ("check configs/can/motors8.dbc",)
RUN = sorted(
    {
        " ".join(f"'{w}'" if re.search(r"[^\w./=:,-]", w) else w for w in words)
        for name, page in PAGES.items()
        if name not in _TESTED
        for words in commands(page)
        if not _ELSEWHERE.search(" ".join(words))
    }
)


def test_there_are_commands_to_run() -> None:
    assert len(RUN) > 20


@pytest.mark.parametrize("line", RUN)
def test_a_command_of_the_pages_works(line: str, tmp_path: Path) -> None:
    for name in ("configs", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["sh", "-ec", f"cosim {line}"], cwd=tmp_path, capture_output=True, text=True, timeout=600,
        env=os.environ | {"PATH": path},
    )  # fmt: skip
    assert done.returncode == (1 if line in _FINDS else 0), done.stdout + done.stderr
