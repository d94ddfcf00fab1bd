"""Chromium by its DevTools protocol over two pipes: pages that stay open."""

from __future__ import annotations

import base64
import json
import os
import select
import subprocess
from collections.abc import Mapping
from pathlib import Path
from time import monotonic, sleep
from typing import Any, Self

import matplotlib

#: s that an answer may take.
PATIENCE = 30.0
#: Keys with their codes and the text that they type.
KEYS = {"Tab": (9, ""), "ArrowRight": (39, ""), "Enter": (13, "\r")}


#: The only fonts that pages are shown with, and how their edges are drawn, on every machine.
FONTS = """<?xml version="1.0"?><!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig><dir>{folder}/fonts/ttf</dir><cachedir>{cache}</cachedir>
{names}
<match target="font"><edit name="antialias" mode="assign"><bool>true</bool></edit>
<edit name="hinting" mode="assign"><bool>false</bool></edit>
<edit name="rgba" mode="assign"><const>none</const></edit></match></fontconfig>"""


#: How a family that the machine chooses is named, and what it is here.
FAMILIES = {"system-ui": "DejaVu Sans", "sans-serif": "DejaVu Sans", "sans": "DejaVu Sans",
            "ui-monospace": "DejaVu Sans Mono", "monospace": "DejaVu Sans Mono"}  # fmt: skip
ALIAS = (
    """<alias binding="strong"><family>{}</family><prefer><family>{}</family></prefer></alias>"""
)


def same_fonts(folder: Path) -> Path:
    """A file for fontconfig, in the `folder`, that knows matplotlib's fonts and no others."""
    folder.mkdir(parents=True, exist_ok=True)
    given = {"folder": matplotlib.get_data_path(), "cache": folder / "fonts"}
    path = folder / "fonts.conf"
    names = "".join(ALIAS.format(*pair) for pair in FAMILIES.items())
    path.write_text(FONTS.format(**given, names=names), encoding="utf-8")
    return path


class Browser:
    """A headless browser with one page; to be used in `with`."""

    def __init__(self, program: str, profile: Path) -> None:
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        self._process = subprocess.Popen(
            ["bash", "-c", f'exec "$@" 3<&{to_browser} 4>&{from_browser}', "bash", program,
             "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
             f"--user-data-dir={profile}", "--window-size=1280,2300",
             "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"],
            pass_fds=(to_browser, from_browser), stderr=subprocess.DEVNULL,
            env={**os.environ, "FONTCONFIG_FILE": str(same_fonts(profile))},
        )  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._buffer, self.console = 0, b"", list[str]()
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        attached = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})
        self._session: str | None = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self._call(f"{domain}.enable", {}, self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._in)
        os.close(self._out)

    def open(self, url: str) -> None:
        """Go to an address."""
        self._call("Page.navigate", {"url": url}, self._session)

    def ask(self, script: str) -> Any:
        """The value of an expression in the page."""
        given = {"expression": script, "returnByValue": True, "awaitPromise": True}
        answer = self._call("Runtime.evaluate", given, self._session)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, script: str, seconds: float = PATIENCE) -> Any:
        """Wait until an expression is true; its value."""
        end = monotonic() + seconds
        while not (value := self.ask(script)):
            assert monotonic() < end, f"never true: {script}; console: {self.console}"
            sleep(0.1)
        return value

    def shot(self, path: Path) -> None:
        """Write a picture of the page, PNG."""
        path.write_bytes(self.picture())

    def picture(self) -> bytes:
        """A picture of what the window shows, PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", {}, self._session)["data"])

    def pdf(self) -> bytes:
        """The page as it is printed."""
        given = {"printBackground": True}
        return base64.b64decode(self._call("Page.printToPDF", given, self._session)["data"])

    def size(self, width: int, height: int) -> None:
        """Show the page in a window of this size, pixels."""
        given = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", given, self._session)

    def emulate(self, media: str = "", features: Mapping[str, str] | None = None) -> None:
        """Show the page as for a medium ("print"), and with these CSS media features."""
        pairs = [{"name": name, "value": value} for name, value in (features or {}).items()]
        given = {"media": media, "features": pairs}
        self._call("Emulation.setEmulatedMedia", given, self._session)

    def key(self, name: str) -> None:
        """Press and release a key of `KEYS`."""
        code, text = KEYS[name]
        key = {"key": name, "code": name, "windowsVirtualKeyCode": code}
        down = {"type": "keyDown", **key, **({"text": text} if text else {})}
        self._call("Input.dispatchKeyEvent", down, self._session)
        self._call("Input.dispatchKeyEvent", {"type": "keyUp", **key}, self._session)

    def _call(
        self, method: str, parameters: Mapping[str, Any], session: str | None = None
    ) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self._note(answer)

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            assert select.select([self._in], [], [], PATIENCE)[0], "the browser says nothing"
            self._buffer += os.read(self._in, 1 << 20)
        text, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(text))

    def _note(self, event: Mapping[str, Any]) -> None:
        """Errors that the page has made, and what it has said to its console."""
        said = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            details = said["exceptionDetails"]
            self.console.append(details.get("exception", details).get("description", "error"))
        if event.get("method") == "Runtime.consoleAPICalled":
            self.console.append(str([a.get("value") for a in said["args"]]))
        if event.get("method") == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.console.append(f"{said['entry']['text']} {said['entry'].get('url', '')}")
