"""A node's plan as C takes it: what it receives, what it sends, on which buses and clock.

In come a system, open buses and a clock, out comes the C struct of a node with everything it points
to. An outlet goes from a signal to a frame (guard, codec, protection), an inlet from a frame to a
signal (receiver, delay line, drive).
"""
