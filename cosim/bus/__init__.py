"""A CAN bus in simulated time, and its mathematics: bits, stuffing, frame and response times.

The simulation counts in ps, the mathematics in bits and ns. Neither uses sockets or clocks.
"""
