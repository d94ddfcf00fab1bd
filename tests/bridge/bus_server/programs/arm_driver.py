"""A driver of an arm as LeRobot's: a thread that reads the bus, a loop with an exact period."""

import struct
import threading
import time

import can

PERIOD, SPIN = 0.01, 0.001


def precise_sleep(seconds: float) -> None:
    """Sleep for most of the time, and spin for the rest."""
    end = time.perf_counter() + seconds
    if seconds > SPIN:
        time.sleep(seconds - SPIN)
    while time.perf_counter() < end:
        pass


def read(bus: can.BusABC, positions: dict[int, float], stop: threading.Event) -> None:
    while not stop.is_set():
        message = bus.recv(0.002)
        if message is not None:
            positions[message.arbitration_id - 0x10] = struct.unpack("<f", message.data[:4])[0]


bus, positions, stop = can.Bus(), dict[int, float](), threading.Event()
reader = threading.Thread(target=read, args=(bus, positions, stop))
reader.start()
previous = None
for step in range(20):
    start = time.perf_counter()
    for motor in range(1, 4):
        data = struct.pack("<ff", motor + step / 100, 0.0)
        bus.send(can.Message(arbitration_id=motor, data=data, is_extended_id=False))
    precise_sleep(0.002)
    seen = " ".join(f"{positions.get(motor, 0):.2f}" for motor in range(1, 4))
    print(f"{start - previous if previous else PERIOD:.4f} {seen}")
    previous = start
    precise_sleep(PERIOD - (time.perf_counter() - start))
stop.set()
reader.join()
bus.shutdown()
