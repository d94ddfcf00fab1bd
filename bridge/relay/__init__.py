"""A network with given delays and losses, in user space: for tests on a real IP stack.

Hosts are network namespaces, each with one TUN interface; the router between them is a process of
this project. Delays and losses of each directed link are drawn separately from the laws of
:mod:`cosim.links`, with a seed, and the result for every packet is recorded. Requires Linux and
root.
"""
