"""A UDS client whose server answers one request in time, and the next one never."""

import threading
import time

import can
import isotp
import udsoncan
from udsoncan.client import Client
from udsoncan.connections import PythonIsoTpConnection

NORMAL = isotp.AddressingMode.Normal_11bits


def serve(bus: can.BusABC) -> None:
    while True:
        request = bus.recv()
        if request is not None and request.arbitration_id == 0x7E0:
            time.sleep(0.03)
            answer = [0x02, 0x7E, 0x00, 0xAA, 0xAA, 0xAA, 0xAA, 0xAA]
            bus.send(can.Message(arbitration_id=0x7E8, data=answer, is_extended_id=False))
            return


server, bus = can.Bus(), can.Bus()
threading.Thread(target=serve, args=(server,), daemon=True).start()
stack = isotp.CanStack(bus, address=isotp.Address(NORMAL, rxid=0x7E8, txid=0x7E0))
config = {**udsoncan.configs.default_client_config, "p2_timeout": 0.15, "use_server_timing": False}
with Client(PythonIsoTpConnection(stack), config=config) as client:
    start = time.monotonic()
    client.tester_present()
    print(f"answered after {time.monotonic() - start:.3f} s")
    start = time.monotonic()
    try:
        client.tester_present()
    except udsoncan.exceptions.TimeoutException:
        print(f"no answer after {time.monotonic() - start:.3f} s")
for each in (server, bus):
    each.shutdown()
