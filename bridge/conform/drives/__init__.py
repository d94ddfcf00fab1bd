"""A black-box kit that judges a drive by its vendor's document: Damiao, ODrive or CiA 402.

``lines`` has the bus of a drive, real or emulated in simulated time, ``bench`` asks and listens,
``kit`` judges, and ``damiao``, ``odrive`` and ``cia402`` have the rules of each protocol.
"""
