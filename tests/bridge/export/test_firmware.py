"""Firmware of nodes: images that do, slot by slot, what the twin does, to the bit."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from bridge.deployment.system import System
from bridge.export.firmware import firmware
from tests.bridge.deployments import named
from tests.bridge.export.records import Pipes, differences, image, record, recorded


def built(system: System, node: str, folder: Path, target: str = "native") -> Path:
    """The image of a node."""
    made = firmware(system, node, target)
    for name, text in made.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    done = subprocess.run(["make", "-j2", "-C", folder], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr
    return folder / "image.elf"


#: Samples wait in a queue: their delays fall.
QUEUES = [
    f"links.{i}.{key}"
    for i in (0, 1)
    for key in (
        'semantics="queue"',
        "depth=5",
        'delay={law="segments", delay="20 ms", segments=[{from=0, to="0.1 s", delay="0.15 s"}]}',
    )
]


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize(
    ("node", "settings"),
    [("master_control", ()), ("master_control", QUEUES), ("master", ())],
    ids=["controller", "queue", "arm"],
)
def test_a_native_image_has_the_journals_and_frames_of_the_twin(
    node: str, settings: Sequence[str], tmp_path: Path
) -> None:
    system = named("can", "run.stop=0.5", *settings)
    found = recorded(system, node, tmp_path / "twin")
    with image(Pipes(built(system, node, tmp_path / "image"))) as host:
        assert differences(host, found) == []
        host.say(record("q"))
        assert host.until("l")["l"] == [b"bytes skipped: 0"]
