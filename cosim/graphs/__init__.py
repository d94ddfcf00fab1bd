"""Graphs of communication: named ones, switching between them, and the weights of their edges.

Which edges of a network of robots are there, in the order in which it is built up::

    graph       weighted directed graphs, their roots and union; presets of six robots
    named       graphs of any size by name, and graphs in files
    switching   which graph when: always one, at random, by a schedule
    topology    the weights of each receiver's edges as a stream of rows
"""
