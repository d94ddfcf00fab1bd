"""A Linux kernel with SocketCAN for one command, if the host's own kernel has none.

``python -m bridge.vcan run -- COMMAND`` runs the command in a separate network with ``vcan0``,
``vcan1``, ...: on the host's kernel if that has CAN, otherwise on User-Mode Linux, a Linux kernel
that is an ordinary process (https://docs.kernel.org/virt/uml/user_mode_linux_howto_v2.html) and
uses this machine's files.
"""
