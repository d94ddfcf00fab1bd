"""Motor drives: profiles of their messages, and the emulated drive of a plant.

Input: profile files (``configs/drives/NAME.toml``) and SDO answers. Output: codecs, limits and
enabling sequences. A new drive needs a profile, and a module here only for a new protocol.
"""
