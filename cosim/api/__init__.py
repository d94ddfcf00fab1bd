"""The Python interface: what ``import cosim`` offers, beside the command line.

In come scenarios (files, or documents with the same keys), studies and run folders; out come
results with arrays, tables and pictures. The names are listed in ``cosim/__init__.py``, which
imports them when they are used. The rooms below do the work; nothing here computes.
"""
