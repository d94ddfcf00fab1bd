"""Recordings of other programs as links: delays, losses, and the clocks that they were measured by.

Input: MCAP, rosbag2, pcap, pcapng, candump, ASC, BLF or CSV, of one end or of both. Output: the
delays of a stream with stated uncertainty, and the link that repeats them.
"""
