"""Small changes of the code, one at a time, and the tests that have to fail.

:mod:`tests.mutants.__main__` is the command; :mod:`tests.mutants.changes` says what is changed.
"""
