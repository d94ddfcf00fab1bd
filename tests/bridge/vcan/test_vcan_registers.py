"""Registers of a traced process are set by a kernel that does not know all of them."""

from __future__ import annotations

import ctypes as c
import os
import platform
import subprocess
import sys

import pytest

from bridge.native import library

PEEK_TEXT, PEEK_DATA, PEEK_USER, ATTACH, DETACH, GET, SET = 1, 2, 3, 16, 17, 0x4204, 0x4205
GENERAL, XSTATE = 1, 0x202
RIP = 16  # number among the general registers
#: Bytes: up to the bits of what is used; x87, SSE and the header, every host with AVX has more.
USED, SSE, LARGEST = 512, 576, 16384

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="x86-64 Linux only"
)


class IoVec(c.Structure):
    _fields_ = (("base", c.c_void_p), ("length", c.c_size_t))


class Traced:
    """A process; called with a request, it is what ptrace() of our library gives."""

    def __init__(self, pid):
        self.pid, self.function = pid, library().ptrace
        self.function.argtypes = (c.c_long, c.c_long, c.c_void_p, c.c_void_p)
        self.function.restype = c.c_long

    def __call__(self, request, at, what):
        return self.function(request, self.pid, at, what)


@pytest.fixture
def traced():
    process = subprocess.Popen(["sleep", "60"])
    found = Traced(process.pid)
    if found(ATTACH, None, None):
        pytest.skip("processes cannot be traced here")
    os.waitpid(process.pid, 0)
    yield found
    found(DETACH, None, None)
    process.kill()
    process.wait()


def registers(traced, size):
    buffer = (c.c_uint8 * size)()
    what = IoVec(c.addressof(buffer), size)
    assert traced(GET, XSTATE, c.byref(what)) == 0
    return buffer, what


def test_a_whole_set_is_the_kernels_to_judge(traced):
    """A bit of registers that no processor has is refused there."""
    buffer, whole = registers(traced, LARGEST)
    buffer[USED + 5] |= 1
    assert traced(SET, XSTATE, c.byref(whole)) == -1


def test_fewer_than_the_host_has_can_be_set(traced):
    """What is not given is as it is at first; bits of what no processor has count nothing."""
    _, whole = registers(traced, LARGEST)
    if whole.length <= SSE:
        pytest.skip("this processor has no more")
    buffer, known = registers(traced, SSE)
    buffer[160] ^= 0xFF  # XMM0
    buffer[USED] |= 2  # which is then in use
    buffer[USED + 5] |= 1  # no processor has this
    assert traced(SET, XSTATE, c.byref(known)) == 0
    again, _ = registers(traced, LARGEST)
    assert bytes(again[160:416]) == bytes(buffer[160:416])
    assert bytes(again[SSE : whole.length]) == bytes(whole.length - SSE)
    assert again[USED + 5] == 0


@pytest.mark.parametrize(("size", "result"), [(USED + 8, 0), (USED, -1), (LARGEST, 0)])
def test_a_set_has_at_least_the_bits_of_what_is_used(traced, size, result):
    """Less than that is the kernel's to refuse; all of the host's it takes as before."""
    _, given = registers(traced, size)
    assert traced(SET, XSTATE, c.byref(given)) == result


@pytest.mark.parametrize("looks", [PEEK_TEXT, PEEK_DATA])
def test_what_is_looked_at_is_in_the_memory_of_the_process(traced, looks):
    at = traced(PEEK_USER, 8 * RIP, None)
    assert at > 0
    with open(f"/proc/{traced.pid}/mem", "rb") as memory:
        memory.seek(at)
        expected = int.from_bytes(memory.read(8), sys.byteorder, signed=True)
    assert traced(looks, at, None) == expected


def test_other_sets_of_registers_are_as_they_were_given(traced):
    general = (c.c_uint64 * 27)()
    what = IoVec(c.addressof(general), c.sizeof(general))
    assert traced(GET, GENERAL, c.byref(what)) == 0
    assert general[RIP] == traced(PEEK_USER, 8 * RIP, None)
    general[0] ^= 0x1234  # R15
    assert traced(SET, GENERAL, c.byref(what)) == 0
    assert traced(PEEK_USER, 0, None) == c.c_long(general[0]).value


def test_a_place_that_is_none_is_refused(traced):
    assert traced(PEEK_USER, 1 << 40, None) == -1
