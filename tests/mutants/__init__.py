"""Whether the tests notice defects: one small change of the code, and the tests that have to fail.

:mod:`tests.mutants.__main__` is the command; :mod:`tests.mutants.changes` says what is changed.
"""
