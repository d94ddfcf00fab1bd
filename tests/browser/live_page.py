"""Pages that compute runs, opened in a browser, and what they show."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.browser.devtools import Browser

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "teleoperation.toml"
#: Bytes of a page, at the most.
MOST = 2_500_000


def opened(browser: Browser, page: Path, script: str, ready: str = "true") -> dict[str, Any]:
    """The content of the page as soon as it is `ready` (JavaScript) and can compute.

    `script`: JavaScript that gives the content as JSON.
    """
    browser.console.clear()
    browser.open("about:blank")
    browser.open(page.as_uri())
    browser.until(ready)
    browser.until("document.getElementById('live')?.hidden === false")
    return seen(browser, script)


def seen(browser: Browser, script: str) -> dict[str, Any]:
    """The content of the page that is open."""
    found: dict[str, Any] = json.loads(browser.ask(script))
    return found
