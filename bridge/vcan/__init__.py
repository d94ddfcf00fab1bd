"""A Linux kernel with SocketCAN for one command, where the host's own has none.

``python -m bridge.vcan run -- COMMAND`` runs the command in a network of its own with ``vcan0``,
``vcan1``, ...: on the host's kernel where that has CAN, else on User-Mode Linux, a Linux kernel
that is an ordinary process (https://docs.kernel.org/virt/uml/user_mode_linux_howto_v2.html) and
works on this machine's files.
"""
