"""Three motors on one bus object: each answers a command with its position, 150 us later."""

import time

import can

with can.Bus() as bus:
    while True:
        message = bus.recv()
        if message is not None and message.arbitration_id < 0x10:
            time.sleep(150e-6)
            name = message.arbitration_id + 0x10
            bus.send(can.Message(arbitration_id=name, data=message.data, is_extended_id=False))
