"""Make the pictures of README.md: ``python docs/pictures/make.py`` in the checkout.

A run becomes a GIF of its arms, and the report of a rehearsal, in the time of simulated buses, a
picture of the page as the browser `chromium` shows it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
COSIM = str(Path(sys.executable).with_name("cosim"))
SCENARIO = "configs/teleoperation.toml"
#: Width and height of the page, and the part of it that is kept, pixels.
WINDOW, KEPT = (1100, 1700), (0, 0, 1100, 1240)


def arms(folder: Path) -> None:
    """Write ``arms.gif``: the arms of the first 20 s."""
    cosim("run", SCENARIO, "--set", "run.stop=20", "--no-plot", "--out", str(folder))
    cosim("export", str(folder), "--to", str(HERE / "arms.gif"))


def rehearsal(folder: Path) -> None:
    """Write ``rehearsal.png``: the beginning of the report of a rehearsal of 20 s."""
    how = ("--deploy", "can", "-i", "cosim", "--clock", "simulated", "--set", "run.stop=20")
    cosim("rehearse", SCENARIO, *how, "--out", str(folder))
    page, picture = folder / "report.html", folder / "page.png"
    subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--hide-scrollbars",
         "--virtual-time-budget=5000", f"--window-size={WINDOW[0]},{WINDOW[1]}",
         f"--screenshot={picture}", f"{page.as_uri()}#t=3"],
        check=True, capture_output=True,
    )  # fmt: skip
    with Image.open(picture) as image:
        image.crop(KEPT).convert("RGB").quantize(64).save(HERE / "rehearsal.png", optimize=True)


def cosim(*arguments: str) -> None:
    """Run a command. Raises CalledProcessError."""
    subprocess.run([COSIM, *arguments], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    with TemporaryDirectory() as scratch:
        arms(Path(scratch) / "run")
        rehearsal(Path(scratch) / "rehearsal")
