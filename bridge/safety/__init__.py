"""Limits of what a node may do: guards, watchdogs and start conditions.

In comes what a deployment says of them, out come the C structs that enforce them
(``bridge/c/guard.h``, ``life.h``) and the reasons of a stop in words.
"""
