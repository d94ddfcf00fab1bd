"""The bridge's C library (``bridge/c``) as ctypes sees it: one module a header."""

from bridge.native.library import library, library_path

__all__ = ["library", "library_path"]
