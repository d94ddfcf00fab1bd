"""A network that delays and loses packets as told, in user space: for tests on a real IP stack.

Hosts are network namespaces, each with one TUN interface; the router between them is a process of
ours. What happens to a packet is drawn from the laws of :mod:`cosim.links`, seeded, a directed link
on its own, and what became of every packet is recorded. Linux, as root.
"""
