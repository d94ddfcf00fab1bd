"""A CANopen node with one object and a heartbeat of 100 ms."""

import time

import canopen

dictionary = canopen.ObjectDictionary()
variable = canopen.objectdictionary.ODVariable("value", 0x2000)
variable.data_type = canopen.objectdictionary.UNSIGNED32
variable.access_type = "rw"
dictionary.add_object(variable)
network = canopen.Network()
network.connect()
node = network.create_node(2, dictionary)
node.nmt.state = "OPERATIONAL"
node.nmt.start_heartbeat(100)
time.sleep(3600)
