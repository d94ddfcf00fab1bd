"""What a node asks of the system: granted or refused with a reason, and always given back."""

from __future__ import annotations

import errno
import gc
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.realtime import os_grants
from bridge.realtime.lateness import lateness
from bridge.realtime.requests import (
    REQUIRED,
    Realtime,
    RealtimeError,
    enter,
    warm_up,
    warm_up_warning,
)
from cosim.base.copies import replace
from cosim.base.errors import CosimError
from tests.garbage import freeze, unfreeze

ROOT = Path(__file__).parents[3]
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
NAMES = [name for name, *_ in os_grants.ASKED]
#: Only what touches this process's Python.
TAME = Realtime(priority=0, timer_slack_ns=0, lock_memory=False, cpu_latency_us=None)

CHILD = """
import ctypes, json, os, resource, sys, threading
from bridge.native import pace
from bridge.realtime.requests import Realtime, RealtimeError, enter
pace.now()
if sys.argv[1] == "plain":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (8 << 20, 8 << 20))
    if os.getuid() == 0:
        os.setgroups([]); os.setgid(65534); os.setuid(65534)
def descriptors():
    return [f"/proc/self/fd/{name}" for name in os.listdir("/proc/self/fd")]
def state():
    status = dict(l.split(":", 1) for l in open("/proc/thread-self/status") if ":" in l)
    flag = getattr(os, "SCHED_RESET_ON_FORK", 0)
    return {"policy": os.sched_getscheduler(0) & ~flag, "cpus": sorted(os.sched_getaffinity(0)),
            "priority": os.sched_getparam(0).sched_priority, "locked": status["VmLck"].split()[0],
            "slack": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0),
            "latency": any("dma_lat" in file for file in map(os.path.realpath, descriptors()))}
out = {"before": state()}
spec = Realtime(cpus=(min(os.sched_getaffinity(0)),), priority=7)
with enter(spec) as granted:
    out["facts"], out["inside"] = granted.facts(), state()
    thread = threading.Thread(target=lambda: out.update(thread=state()))
    thread.start(); thread.join()
out["after"] = state()
try:
    enter(Realtime(mode="enforce")).leave()
    out["enforced"] = ""
except RealtimeError as error:
    out["enforced"] = str(error)
out["last"] = state()
print(json.dumps(out))
"""


def child(how: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", CHILD, how], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def privileged() -> dict[str, Any]:
    return child("as it is")


def granted(found: dict[str, Any]) -> dict[str, bool]:
    return {item["name"]: item["granted"] for item in found["facts"]["items"]}


@LINUX
def test_what_is_granted_is_so_and_is_given_back(privileged: dict[str, Any]) -> None:
    found = privileged
    yes, inside = granted(found), found["inside"]
    assert list(yes) == NAMES
    assert found["after"] == found["last"] == found["before"]
    if yes["scheduler"]:
        assert (inside["policy"], inside["priority"]) == (os.SCHED_FIFO, 7)
    if yes["memory"]:
        assert int(inside["locked"]) > 0
    assert len(inside["cpus"]) == 1
    assert inside["latency"] == yes["idle states"]
    assert all(item["said"] for item in found["facts"]["items"])
    assert (found["enforced"] == "") == all(yes[name] for name in REQUIRED)


@LINUX
def test_threads_started_later_are_not_real_time_ones(privileged: dict[str, Any]) -> None:
    assert privileged["thread"]["policy"] == os.SCHED_OTHER


@LINUX
def test_without_privileges_it_says_what_is_needed() -> None:
    found = child("plain")
    yes = granted(found)
    said = {item["name"]: item["said"] for item in found["facts"]["items"]}
    assert not yes["scheduler"]
    assert "EPERM: priority 7 needs CAP_SYS_NICE or `ulimit -r` of 7 or more; found 0" in said[
        "scheduler"
    ]  # fmt: skip
    assert not yes["memory"]
    assert "RLIMIT_MEMLOCK is 8 MiB; needs CAP_IPC_LOCK" in said["memory"]
    assert yes["timer slack"]
    assert found["inside"]["slack"] == 1
    assert yes["garbage collector"]
    assert found["after"] == found["last"] == found["before"]
    for part in ("real time is enforced and was not granted: scheduler: EPERM", "memory: ENOMEM"):
        assert part in found["enforced"]


@pytest.fixture(autouse=True)
def thawed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Python's own ways to freeze objects, which tests/conftest.py replaces, and none frozen."""
    unfreeze()
    monkeypatch.setattr(gc, "freeze", freeze)
    monkeypatch.setattr(gc, "unfreeze", unfreeze)
    yield
    gc.collect()
    freeze()


def python() -> tuple[bool, int, float]:
    return gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()


def test_python_is_put_back_and_leaving_twice_is_leaving_once() -> None:
    before = python()
    with enter(TAME) as found:
        assert (gc.isenabled(), gc.get_freeze_count() > 0) == (False, True)
        assert sys.getswitchinterval() == pytest.approx(0.5e-3)
        found.leave()
        assert python() == before
    assert python() == before
    assert [item.name for item in found.items] == ["garbage collector", "switch interval"]
    assert found.refused == ()
    header, *rows, last = found.rows()
    assert header[:2] == ["asked for", "granted"]
    assert {row[1] for row in rows} == {"yes"}
    assert last == ["kernel", "", found.kernel]


def test_a_collector_that_was_off_stays_off() -> None:
    gc.disable()
    try:
        enter(TAME).leave()
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.parametrize("spec", [replace(TAME, priority=100), replace(TAME, cpus=(-1,))])
def test_what_cannot_be_is_refused_before_anything_is_done(spec: Realtime) -> None:
    before = python()
    with pytest.raises(CosimError, match=r"real time: found .*expected"):
        enter(spec)
    assert python() == before


def refusing(code: int) -> Any:
    def call(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    return call


@LINUX
def test_a_container_that_forbids_it_although_the_limits_allow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refusing(errno.EPERM))
    monkeypatch.setattr(os_grants, "_limit", lambda name: 99)
    found = enter(replace(TAME, priority=50))
    found.leave()
    assert [item.name for item in found.refused] == ["scheduler"]
    assert "within the limits" in found.refused[0].said
    before = python()
    with pytest.raises(RealtimeError, match="scheduler: EPERM"):
        enter(replace(TAME, priority=50, mode="enforce"))
    assert python() == before


@LINUX
def test_cpus_that_are_not_there() -> None:
    before = os.sched_getaffinity(0)
    with enter(replace(TAME, cpus=(min(before), 1000))) as found:
        assert os.sched_getaffinity(0) == before
    assert "EINVAL" in found.refused[0].said
    with pytest.raises(RealtimeError, match="cpus: EINVAL"):
        enter(replace(TAME, cpus=(1000,), mode="enforce"))


@LINUX
@pytest.mark.parametrize(
    ("code", "said"), [(errno.EACCES, "udev rule"), (errno.ENOENT, "containers")]
)
def test_idle_states_help_and_are_never_insisted_on(
    monkeypatch: pytest.MonkeyPatch, code: int, said: str
) -> None:
    monkeypatch.setattr(os, "open", refusing(code))
    with enter(replace(TAME, cpu_latency_us=0, mode="enforce")) as found:
        assert said in found.refused[0].said


def test_elsewhere_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with enter(replace(TAME, priority=50, cpus=(0,), timer_slack_ns=1)) as found:
        assert [item.name for item in found.refused] == ["cpus", "timer slack", "scheduler"]
        assert all("no such thing" in item.said for item in found.refused)


def test_the_kernel_is_named() -> None:
    found = os_grants.kernel()
    assert "isolated CPUs" in found
    if sys.platform == "linux":
        assert any(kind in found for kind in ("PREEMPT", "no PREEMPT"))


def test_a_warm_up_waits_for_every_deadline() -> None:
    found = warm_up(500_000, 0.02)
    assert (found.late.count, found.period_ns) == (40, 500_000)
    assert found.late.minimum >= 0
    assert warm_up(10_000_000, 0.0).late.count == 2


def test_a_node_that_wakes_too_late_is_not_armed() -> None:
    good = lateness([0, 1000, 2000], [200, 1200, 2200], 1000)
    bad = lateness([0, 1000, 2000], [0, 1000, 2201], 1000)
    assert warm_up_warning(good, "enforce") == warm_up_warning(good, "ask") == ""
    assert "20 % of the period" in warm_up_warning(bad, "ask")
    with pytest.raises(RealtimeError, match="did not arm: warm-up of 3 slots"):
        warm_up_warning(bad, "enforce")
