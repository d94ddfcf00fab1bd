"""A real browser: pages with a script at their end, which says what it saw."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.devtools import Browser

BEFORE = """<script>window.said = [];
addEventListener("error", (e) => said.push(`error: ${e.message}`));
addEventListener("securitypolicyviolation", (e) => said.push(`policy: ${e.blockedURI}`));
</script>"""
AFTER = """<pre id="seen"></pre><script>
const tell = (seen) => {
  const found = {...seen, said, ready: document.body.dataset.ready};
  document.getElementById("seen").textContent = JSON.stringify(found);
};
SCRIPT</script>"""


@pytest.fixture(scope="session")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        assert not os.environ.get("CI"), "no chromium"
        pytest.skip("no chromium on this machine")
    return found


@pytest.fixture(scope="module")
def browser(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(chromium, tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture(scope="session")
def browse(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """A page after five seconds of its own time, as HTML; a picture of it with `shot`."""

    def call(page: Path, *options: str) -> str:
        profile = tmp_path_factory.mktemp("profile")
        done = subprocess.run(
            [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--user-data-dir={profile}", "--window-size=1280,1600", "--virtual-time-budget=5000",
             "--host-resolver-rules=MAP * ~NOTFOUND", *options, page.as_uri()],
            capture_output=True, text=True, timeout=120, check=True,
        )  # fmt: skip
        return done.stdout

    return call


@pytest.fixture
def ask(browse: Callable[..., str], tmp_path: Path) -> Callable[[Path, str], dict[str, Any]]:
    """The object that a script at the end of a page hands to `tell`; errors and requests fail."""

    def call(path: Path, script: str) -> dict[str, Any]:
        text = path.read_text(encoding="utf-8").replace("<style>", BEFORE + "<style>", 1)
        page = tmp_path / "asked.html"
        text = text.replace("</body>", AFTER.replace("SCRIPT", script) + "</body>", 1)
        page.write_text(text, encoding="utf-8")
        found = re.search(r'<pre id="seen">(.*?)</pre>', browse(page, "--dump-dom"), re.S)
        assert found is not None
        text = found[1].replace("&gt;", ">").replace("&lt;", "<").replace("&amp;", "&")
        seen: dict[str, Any] = json.loads(text)
        assert seen["said"] == [] and seen["ready"] == "yes"
        return seen

    return call
