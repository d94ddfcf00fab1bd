"""Conformance: whole FMUs against the standards, whoever made them, and what is called of them.

`watch` puts a library between an importer and an FMU that writes down every call; `machine2` and
`machine3` are the state machines of FMI 2.0.5 and 3.0.2, which judge such a list. Tests of single
modules of the importer are in tests/cosim/fmi, those of our own FMUs as files in tests/fmus.
"""
