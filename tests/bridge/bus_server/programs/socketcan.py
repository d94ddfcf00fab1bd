"""Two buses of python-can's interface socketcan, one of them with a filter."""

import time

import can

filters = [{"can_id": 0x120, "can_mask": 0x7F0, "extended": False}]
with (
    can.Bus(interface="socketcan", channel="can0", receive_own_messages=True) as a,
    can.Bus(interface="socketcan", channel="can0", can_filters=filters) as b,
):
    time.sleep(0.01)
    a.send(can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False))
    a.send(can.Message(arbitration_id=0x223, data=bytes(8), is_extended_id=False))
    for bus in (b, a):
        message = bus.recv(1)
        print(f"{message.timestamp:.6f} {message.arbitration_id:03x} {message.is_rx}")
    if b.recv(0.1) is None:
        print("no more")
