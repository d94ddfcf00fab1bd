"""Sends a message of 100 bytes by ISO-TP, and prints all frames of the bus with their times."""

import time

import can
import isotp

with can.Bus(interface="cosim", channel="bench") as bus, can.Bus() as spy:
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, rxid=0x7E8, txid=0x7E0)
    stack = isotp.CanStack(bus, address=address, params={"blocking_send": True})
    stack.start()
    time.sleep(0.1)
    stack.send(bytes(range(100)), send_timeout=5)
    stack.stop()
    while (message := spy.recv(0.01)) is not None:
        print(f"{message.timestamp:.7f} {message.arbitration_id:03X} {message.data.hex()}")
