"""Zenoh as a bus: configuration, session, channel, presence, remote control.

Input: the options of a deployment's bus and the rings of a node. Output: samples under its keys
and answers to queries of a node. Only this package imports `zenoh`;
`options` does without, so that the twin and the replay of a deployment open no session.
"""
