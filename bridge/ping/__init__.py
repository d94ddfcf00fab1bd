"""Round trips on a path of one's own: how late it is, each way, why, and as a link of a scenario.

Input: a path (UDP, Zenoh, CAN) with a responder or a drive at the other end, or traffic to listen
to. Output: figures of the delays with stated uncertainty, a trace, and the link that repeats it.
"""
