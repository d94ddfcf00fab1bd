"""Implementation of each request to the operating system, with the reason for a refusal.

Linux only; on other systems all requests except Python's own settings are refused and reported as
such. Every setting is put on a stack that restores it.
"""

from __future__ import annotations

import ctypes as c
import errno
import gc
import os
import platform
import struct
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

Mode = Literal["ask", "enforce"]

_DMA_LATENCY = Path("/dev/cpu_dma_latency")
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # linux/mman.h, on all but alpha, powerpc and sparc
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # linux/prctl.h
_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23  # linux/capability.h


@dataclass(frozen=True, slots=True)
class Realtime:
    """Requests to the system for the thread of the tick (:mod:`bridge.realtime.requests`)."""

    mode: Mode = "ask"
    priority: int = 50  # of SCHED_FIFO, 1 to 99; 0: do not ask
    cpus: tuple[int, ...] = ()  # to run on; empty: do not ask
    lock_memory: bool = True
    timer_slack_ns: int = 1  # for threads that are not real-time; 0: do not ask
    cpu_latency_us: int | None = 0  # greatest latency of the CPUs' idle states; None: do not ask
    freeze: bool = True  # what there is leaves the garbage collector, which is turned off
    switch_interval_s: float = 0.5e-3  # after which another Python thread gives the GIL; 0: leave


@dataclass(frozen=True, slots=True)
class Item:
    """One thing asked for, and what came of it."""

    name: str
    granted: bool
    said: str


def _cpus(spec: Realtime, undo: ExitStack) -> str:
    _linux()
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, spec.cpus)
    found = os.sched_getaffinity(0)
    if found != set(spec.cpus):  # the kernel takes those that are there
        os.sched_setaffinity(0, before)
        raise OSError(errno.EINVAL, "some CPUs do not exist")
    undo.callback(os.sched_setaffinity, 0, before)
    return f"CPU {', '.join(map(str, sorted(found)))}"


def _scheduler(spec: Realtime, undo: ExitStack) -> str:
    _linux()
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(0, policy, os.sched_param(spec.priority))
    undo.callback(_schedule, before, parameters)
    return f"SCHED_FIFO, priority {spec.priority}"


def _schedule(policy: int, parameters: Any) -> None:
    """Back to a policy; without privilege the flag that children do not inherit it stays."""
    if sys.platform == "linux":
        try:
            os.sched_setscheduler(0, policy, parameters)
        except PermissionError:
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)


def _timer_slack(spec: Realtime, undo: ExitStack) -> str:
    before = _call("prctl", _PR_GET_TIMERSLACK, 0)
    _call("prctl", _PR_SET_TIMERSLACK, spec.timer_slack_ns)
    undo.callback(_call, "prctl", _PR_SET_TIMERSLACK, before)
    return f"{spec.timer_slack_ns} ns (was {before})"


def _freeze(spec: Realtime, undo: ExitStack) -> str:
    if gc.isenabled():
        undo.callback(gc.enable)
    gc.collect()
    gc.freeze()
    undo.callback(gc.unfreeze)
    gc.disable()
    return f"off, {gc.get_freeze_count()} objects set aside"


def _switch_interval(spec: Realtime, undo: ExitStack) -> str:
    before = sys.getswitchinterval()
    sys.setswitchinterval(spec.switch_interval_s)
    undo.callback(sys.setswitchinterval, before)
    return f"{spec.switch_interval_s * 1e6:g} us (was {before * 1e6:g})"


def _memory(spec: Realtime, undo: ExitStack) -> str:
    """All pages present and future; with a finite limit, future ones would fail: do not try."""
    limit = _limit("RLIMIT_MEMLOCK")
    if limit >= 0 and not _capable(_CAP_IPC_LOCK):
        raise OSError(errno.ENOMEM, "limited")
    _call("mlockall", _MCL_CURRENT | _MCL_FUTURE)
    undo.callback(_call, "munlockall")
    return "locked, present and future pages"


def _cpu_latency(spec: Realtime, undo: ExitStack) -> str:
    latency = spec.cpu_latency_us or 0
    device = os.open(_DMA_LATENCY, os.O_WRONLY)
    undo.callback(os.close, device)  # the kernel drops the wish when the file is closed
    os.write(device, struct.pack("=i", latency))
    return f"at most {latency} us"


ASKED: tuple[tuple[str, Callable[[Realtime], bool], Callable[[Realtime, ExitStack], str]], ...] = (
    ("cpus", lambda s: bool(s.cpus), _cpus),
    ("timer slack", lambda s: s.timer_slack_ns > 0, _timer_slack),  # a real-time thread has none
    ("scheduler", lambda s: s.priority > 0, _scheduler),
    ("garbage collector", lambda s: s.freeze, _freeze),
    ("switch interval", lambda s: s.switch_interval_s > 0, _switch_interval),
    ("memory", lambda s: s.lock_memory, _memory),
    ("idle states", lambda s: s.cpu_latency_us is not None, _cpu_latency),
)


# ---- why not, and what for -----------------------------------------------------------------------


def reason(name: str, spec: Realtime, error: OSError) -> str:
    """The reason why the item `name` was refused, and what would help."""
    code = errno.errorcode.get(error.errno or 0, "error")
    if error.errno == errno.ENOSYS:
        return f"{platform.system()} has no such thing, or not under this name"
    if name == "scheduler":
        return f"{code}: {_no_priority(spec.priority)}"
    if name == "memory":
        limit = _limit("RLIMIT_MEMLOCK")
        shown = "unlimited" if limit < 0 else f"{limit / 2**20:g} MiB"
        return (
            f"{code}: RLIMIT_MEMLOCK is {shown}; needs CAP_IPC_LOCK, or memlock unlimited "
            "(`ulimit -l`)"
        )
    if name == "cpus" and sys.platform == "linux":
        there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        return f"{code}: found {spec.cpus}, expected some of the CPUs {there}"
    if name == "idle states" and error.errno in (errno.EACCES, errno.EPERM):
        return f"{code}: needs write permission on {_DMA_LATENCY} (a udev rule gives it)"
    if name == "idle states" and error.errno == errno.ENOENT:
        return f"{code}: no {_DMA_LATENCY} here (containers, kernels without idle states)"
    return f"{code}: {error.strerror}"


def _no_priority(priority: int) -> str:
    limit = _limit("RLIMIT_RTPRIO")
    if 0 <= limit < priority and not _capable(_CAP_SYS_NICE):
        return (
            f"priority {priority} needs CAP_SYS_NICE or `ulimit -r` of {priority} or more; "
            f"found {limit}"
        )
    return (
        f"priority {priority} is within the limits; the control group gives no real-time runtime, "
        "or a container's filter forbids the call"
    )


def kernel() -> str:
    """Release of the kernel, how it preempts, its throttling, and CPUs kept free for real time."""
    version = platform.version()
    kinds = ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT")
    kind = next((k for k in kinds if k in version), "no PREEMPT")
    parts = [f"{platform.system()} {platform.release()}", kind]
    runtime = _read("/proc/sys/kernel/sched_rt_runtime_us")
    if runtime:
        period = _read("/proc/sys/kernel/sched_rt_period_us")
        parts.append(f"real-time tasks may use {runtime} of {period} us" if runtime != "-1"
                     else "real-time tasks are not throttled")  # fmt: skip
    isolated = _read("/sys/devices/system/cpu/isolated")
    parts.append(f"isolated CPUs {isolated or 'none'}")
    return ", ".join(parts)


def _read(path: str) -> str:
    """The text of a small file; empty where it is not."""
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _limit(name: str) -> int:
    """A soft resource limit, -1: none."""
    if sys.platform == "win32":
        return -1
    import resource

    kinds = {"RLIMIT_MEMLOCK": resource.RLIMIT_MEMLOCK}
    if sys.platform == "linux":
        kinds["RLIMIT_RTPRIO"] = resource.RLIMIT_RTPRIO
    soft, _ = resource.getrlimit(kinds[name])
    return -1 if soft == resource.RLIM_INFINITY else soft


def _capable(capability: int) -> bool:
    """True if this thread has a capability (capabilities(7)) in effect."""
    lines = _read("/proc/thread-self/status").splitlines()
    masks = [line.split()[1] for line in lines if line.startswith("CapEff:")]
    return bool(masks) and bool(int(masks[0], 16) >> capability & 1)


def _call(name: str, *arguments: int) -> int:
    """A function of libc with integer arguments. Raises OSError with its errno."""
    _linux()
    function = _libc()[name]
    function.restype = c.c_int
    result = int(function(*(c.c_ulong(a) for a in arguments)))
    if result < 0:
        raise OSError(c.get_errno(), os.strerror(c.get_errno()))
    return result


@lru_cache(maxsize=1)
def _libc() -> c.CDLL:
    return c.CDLL(None, use_errno=True)


def _linux() -> None:
    if sys.platform != "linux":
        raise OSError(errno.ENOSYS, "not on this system")
