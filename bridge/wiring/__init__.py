"""The plan of a node for C: what it receives, what it sends, on which buses and clock.

Input: a system, open buses and a clock. Output: the C struct of a node with everything it points
to. An outlet goes from a signal to a frame (guard, codec, protection), an inlet from a frame to a
signal (receiver, delay line, drive).
"""
