"""The C engine (``cosim/c``) as ctypes sees it: structs, functions, and what FMUs log."""
