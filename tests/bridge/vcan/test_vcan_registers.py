"""Registers of a traced process are set by a kernel that does not know all of them."""

from __future__ import annotations

import ctypes as c
import os
import platform
import subprocess
import sys

import pytest

from bridge.native import library

PEEK_USER, ATTACH, DETACH, GET, SET = 3, 16, 17, 0x4204, 0x4205
XSTATE = 0x202
AVX = 832  # bytes: x87, SSE, the header, AVX; every host has more

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="x86-64 Linux only"
)


class IoVec(c.Structure):
    _fields_ = (("base", c.c_void_p), ("length", c.c_size_t))


@pytest.fixture
def traced():
    process = subprocess.Popen(["sleep", "60"])
    function = library().ptrace
    function.argtypes = (c.c_long, c.c_long, c.c_void_p, c.c_void_p)
    function.restype = c.c_long
    if function(ATTACH, process.pid, None, None):
        pytest.skip("processes cannot be traced here")
    os.waitpid(process.pid, 0)
    yield lambda request, at, what: function(request, process.pid, at, what)
    function(DETACH, process.pid, None, None)
    process.kill()
    process.wait()


def registers(traced, size):
    buffer = (c.c_uint8 * size)()
    what = IoVec(c.addressof(buffer), size)
    assert traced(GET, XSTATE, c.byref(what)) == 0
    return buffer, what


def test_fewer_than_the_host_has_can_be_set(traced):
    _, whole = registers(traced, 16384)
    if whole.length <= AVX:
        pytest.skip("this processor has no more")
    buffer, known = registers(traced, AVX)
    buffer[160] ^= 0xFF  # XMM0
    buffer[512] |= 2  # which is then in use
    assert traced(SET, XSTATE, c.byref(known)) == 0
    again, _ = registers(traced, 16384)
    assert bytes(again[160:416]) == bytes(buffer[160:416])
    assert bytes(again[AVX : whole.length]) == bytes(whole.length - AVX)


def test_everything_else_is_as_libc_does_it(traced):
    assert traced(PEEK_USER, 8 * 16, None) > 0  # where it stands
    assert traced(PEEK_USER, 1 << 40, None) == -1
