"""Captures that tcpdump made around a relay, in a network namespace."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bridge.captures.evaluation import CaptureChoice, of_two_recordings, read_ends
from bridge.captures.judged import ClockKnowledge

INSIDE = Path(__file__).with_name("relay_in_namespace.py")
NAMESPACE = ("unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")


def test_delays_of_a_relay_between_two_captures(tmp_path: Path) -> None:
    """No packet is faster than the relay lets it be, and what it drops is lost."""
    if os.geteuid() or not all(map(shutil.which, ("tcpdump", "unshare", "ip"))):
        pytest.skip("tcpdump in a network namespace needs root, tcpdump, unshare and ip")
    if subprocess.run([*NAMESPACE, "true"], capture_output=True).returncode:
        pytest.skip("no network namespaces here")
    subprocess.run([*NAMESPACE, sys.executable, INSIDE, tmp_path], check=True, timeout=120)
    truth = json.loads((tmp_path / "truth.json").read_text())
    first, second = read_ends([str(tmp_path / f"{end}.pcap") for end in ("here", "there")])
    choice = CaptureChoice(known=ClockKnowledge("same"))
    result = of_two_recordings(first, second, choice, tmp_path)
    link = result.links[0]
    waits, dropped = np.array(truth["waits"]), np.array(truth["dropped"])
    last = int(np.flatnonzero(~dropped)[-1]) + 1
    np.testing.assert_array_equal(np.isnan(link.delay), dropped[:last])
    assert np.all(link.delay[~dropped[:last]] >= waits[:last][~dropped[:last]])
    assert any("by their payload alone" in remark for remark in result.remarks)
