"""Zenoh as a bus: keys, configuration, session, channel, presence, remote control.

Only this package imports `zenoh` (the extra ``cosim-bridge[zenoh]``); `names` and `options` do
without, so that the twin and the replay of a deployment need no Zenoh.
"""
