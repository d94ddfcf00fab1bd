"""Sends on two buses without waiting, and prints what it hears: two_buses.py NUMBER BUS BUS."""

import random
import sys

import can

from bridge.simulated_can.bus import CosimBus

number = int(sys.argv[1])
with CosimBus(sys.argv[2]) as a, CosimBus(sys.argv[3]) as b:
    assert a.time == b.time == 0.0  # from now on time waits for this thread
    print("there", flush=True)
    sys.stdin.readline()
    drawn = random.Random(number)
    for i in range(100):
        for k in range(drawn.randrange(3)):
            a.send(can.Message(arbitration_id=0x100 * number + k, data=[i], is_extended_id=False))
        if i % 5 == 0:
            b.send(can.Message(arbitration_id=0x700 + number, is_extended_id=False))
        for bus, timeout in ((a, drawn.choice([0, 1e-4, 1e-3])), (b, 0)):
            got = bus.recv(timeout)
            if got is not None:
                print(f"{got.arbitration_id:X} {got.timestamp:.9f} {got.data.hex()}")
