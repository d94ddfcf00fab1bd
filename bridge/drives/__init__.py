"""Motor drives: profiles of their messages, and the emulated drive of a plant.

Input: profile files (``configs/drives/NAME.toml``) and SDO answers. Output: codecs, limits and
enabling sequences. A new drive is a profile; only a protocol of its own needs a module here.
"""
