"""Receives a message of ISO-TP and asks for 5 ms between frames, as programs of can-isotp do."""

import can
import isotp

with can.Bus(interface="cosim", channel="bench") as bus:
    address = isotp.Address(isotp.AddressingMode.Normal_11bits, rxid=0x7E0, txid=0x7E8)
    stack = isotp.CanStack(bus, address=address, params={"stmin": 5, "blocksize": 0})
    stack.start()
    data = stack.recv(block=True, timeout=10)
    print(f"received {len(data or b'')} bytes", flush=True)
    stack.stop()
