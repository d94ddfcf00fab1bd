"""Reads and writes the object of a CANopen node, hears its heartbeats, and misses another node."""

import itertools
import time

import canopen

dictionary = canopen.ObjectDictionary()
variable = canopen.objectdictionary.ODVariable("value", 0x2000)
variable.data_type = canopen.objectdictionary.UNSIGNED32
variable.access_type = "rw"
dictionary.add_object(variable)
network = canopen.Network()
network.connect()
node = network.add_node(2, dictionary)
absent = network.add_node(3, dictionary)
beats = []
node.nmt.add_heartbeat_callback(lambda state: beats.append(node.nmt.timestamp))
time.sleep(0.05)
node.sdo["value"].raw = 12345
print("value", node.sdo["value"].raw)
start = time.monotonic()
try:
    print(absent.sdo["value"].raw)
except canopen.SdoCommunicationError as error:
    print(f"{error} after {time.monotonic() - start:.6f} s")
time.sleep(0.5)
print("heartbeats", *(f"{b - a:.6f}" for a, b in itertools.pairwise(beats)))
network.disconnect()
