"""Mathematics of a CAN bus, without a bus: bits, stuffing, frame times, response times.

In come identifiers, lengths, bytes and periods, out come bits and times in ns.
"""
