"""A script of a live report in Node: it stays open and answers line by line."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

from tests.cosim.live.node import node

#: Numbers that are not finite travel as texts.
ASKED = """
const found = require(process.argv[1]);
const back = (key, x) => (typeof x === "object" && x && "number" in x ? Number(x.number) : x);
const plain = (key, x) => (typeof x === "number" && !Number.isFinite(x) ? { number: String(x) }
  : ArrayBuffer.isView(x) ? [...x] : x);
const answer = new Function("found", process.argv[2])(found);
require("readline").createInterface({ input: process.stdin }).on("line", (line) => {
  process.stdout.write(JSON.stringify(answer(...JSON.parse(line, back)), plain) + "\\n");
});
"""
SPECIAL = {"Infinity": inf, "-Infinity": -inf, "NaN": nan}


class Script:
    """A script whose function `answer` (JavaScript that returns a function) is called."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def __call__(self, *given: Any) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(_sent(given)) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline(), object_hook=_received)


def _sent(x: Any) -> Any:
    if isinstance(x, dict):
        return {key: _sent(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_sent(value) for value in x]
    if isinstance(x, float) and not isfinite(x):
        return {"number": "NaN" if x != x else "Infinity" if x > 0 else "-Infinity"}
    return x


def _received(x: dict[str, Any]) -> Any:
    return SPECIAL[x["number"]] if set(x) == {"number"} else x


@contextmanager
def script(asset: str | Path, answer: str) -> Iterator[Script]:
    """A script of ``cosim/live/assets``, or another file, whose exports are `found`."""
    path = asset if isinstance(asset, Path) else files("cosim.live") / "assets" / asset
    with subprocess.Popen(
        [node(), "-e", ASKED, str(path), answer], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    ) as process:  # fmt: skip
        try:
            yield Script(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
