"""Limits of a node: guards, watchdogs and start conditions.

Input: these tables of a deployment. Output: the C structs that enforce them
(``bridge/c/guard.h``, ``life_cycle.h``) and texts for the reasons of a stop.
"""
