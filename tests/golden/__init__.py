"""Golden digests: what a user gets, frozen, to show what a change of structure changes.

``python -m tests.golden`` compares, ``python -m tests.golden --write`` freezes; see README.md.
"""
