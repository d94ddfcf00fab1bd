"""The commands and files of docs/your-own-arm.md, as somebody who follows the page has them."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from tests.cli.command import ROOT

PAGE = (ROOT / "docs" / "your-own-arm.md").read_text(encoding="utf-8")
_BLOCK = re.compile(r"(?:<!-- (?P<mark>[^>]+) -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A text between two fences: its kind, and what the comment before it says of it."""

    kind: str
    mark: str
    text: str


def blocks() -> list[Block]:
    """All of the page, in their order."""
    found = _BLOCK.finditer(PAGE)
    return [Block(match["kind"], match["mark"] or "", match["text"]) for match in found]


def commands(mark: str = "") -> list[str]:
    """Lines of the shell under this mark, without what the page says of them."""
    texts = [b.text for b in blocks() if b.kind == "sh" and b.mark == mark]
    lines = [line.partition("   #")[0].strip() for text in texts for line in text.splitlines()]
    return [line for line in lines if line]


def prepared(folder: Path) -> Path:
    """The folder ``my_arm`` of the page, with its files and the one for hardware."""
    arm = folder / "my_arm"
    for name in ("drives", "can"):
        shutil.copytree(ROOT / "configs" / name, arm / name)
    (arm / "deploy").mkdir()
    for block in blocks():
        if block.mark.startswith("file "):
            (arm / block.mark.removeprefix("file ")).write_text(block.text, encoding="utf-8")
    text = (arm / "deploy/arm.toml").read_text(encoding="utf-8")
    text = text.replace("vcan0", "can0").replace("vcan1", "can1")
    (arm / "deploy/hardware.toml").write_text(text, encoding="utf-8")
    return arm
