"""CAN: layouts from DBC files, end-to-end protection, buses, logs, bus load."""
