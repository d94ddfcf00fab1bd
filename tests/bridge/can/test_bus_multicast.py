"""udp_multicast in a separate network namespace: no packet leaves this machine."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
INSIDE = Path(__file__).with_name("multicast_in_namespace.py")
SETUP = """
ip link set lo up &&
ip link add leak0 type veth peer name leak1 &&
ip addr add 10.9.0.1/24 dev leak0 && ip link set leak0 up && ip link set leak1 up &&
ip route add default via 10.9.0.2 &&
exec "$@"
"""
NAMESPACE = ("unshare", "--user", "--map-root-user", "--net", "sh", "-c", SETUP, "sh")


@pytest.mark.slow
def test_contract_between_two_processes():
    possible = shutil.which("unshare") and shutil.which("ip")
    if not possible or subprocess.run([*NAMESPACE, "true"], capture_output=True).returncode:
        pytest.skip("no network namespaces here: multicast is not tested outside of one")
    command = [*NAMESPACE, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", INSIDE]
    environment = {**os.environ, "COSIM_TEST_NAMESPACE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    summary = done.stdout.splitlines()[-1] if done.stdout else ""
    assert done.returncode == 0 and "skipped" not in summary, done.stdout[-4000:] + done.stderr
