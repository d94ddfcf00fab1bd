"""Rings between C and threads of Python: sleeping readers are woken, overflow is counted."""

import ctypes
import os
import threading

from bridge.native import pace
from bridge.native.frame import DATA, Frame, Ring
from bridge.native.library import library
from bridge.native.mail import frame_reader, frame_writer, keep_thread
from bridge.zenoh.wakeup import Wake

FAR = 10_000_000_000  # ns; nobody sleeps that long here


def wait(ring: Ring, deadline_ns: int) -> bool:
    return bool(library().mail_wait(ctypes.byref(ring.struct), deadline_ns))


def test_what_is_brought_is_a_frame_that_has_arrived_now():
    ring, frame = Ring(4), Frame()
    before = pace.now()
    frame_writer(ring, 0x1234)(b"a\0b")
    assert ring.get(frame)
    assert (frame.id, frame.payload) == (0x1234, b"a\0b")
    assert before <= frame.t_ns <= pace.now()


def test_what_does_not_fit_is_counted():
    ring = Ring(1)
    bring = frame_writer(ring, 1)
    for data in (bytes(DATA + 1), bytes(DATA), b"full"):
        bring(data)
    assert (len(ring), ring.dropped) == (1, 2)


def test_who_waits_is_woken_each_time():
    here, there, n = Ring(4), Ring(4), 200
    frame = Frame()

    def echo() -> None:
        bring = frame_writer(there, 2)
        for _ in range(n):
            assert wait(here, pace.now() + FAR)
            assert here.get(frame)
            bring(frame.payload)

    thread = threading.Thread(target=echo)
    thread.start()
    bring, back = frame_writer(here, 1), Frame()
    began = pace.now()
    for k in range(n):
        bring(bytes([k]))
        assert wait(there, pace.now() + FAR)
        assert there.get(back)
        assert back.payload == bytes([k])
    thread.join()
    assert pace.now() - began < FAR  # one wake that was missed takes as long


def test_a_wait_for_nothing_ends_at_its_deadline():
    deadline = pace.now() + 1_000_000
    assert not wait(Ring(4), deadline)
    assert pace.now() >= deadline


def test_who_takes_sleeps_until_the_descriptor_is_written_to():
    ring, frame, wake = Ring(4), Frame(), Wake()
    take = frame_reader(ring, wake.out, frame)
    ring.put(Frame.of(7, b"there"))
    assert take() == 1
    assert frame.payload == b"there"

    def write() -> None:
        ring.put(Frame.of(8, b"late"))
        os.write(wake.inn, (1).to_bytes(8, "little"))

    threading.Timer(0.01, write).start()
    assert take() == 1
    assert frame.id == 8
    wake.set()
    assert take() == 0
    wake.close()


def test_a_thread_that_is_kept_ends_as_any_other():
    def twice() -> None:
        keep_thread()
        keep_thread()

    threads = [threading.Thread(target=twice) for _ in range(3)]
    for thread in threads:
        thread.start()
        thread.join()
