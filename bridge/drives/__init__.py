"""Motor drives: profiles of what they say on a bus, and the emulated drive of a plant.

In come profile files (``configs/drives/NAME.toml``) and SDO answers, out come codecs, limits and
enabling sequences. A new drive is a profile; only a protocol of its own needs a module here.
"""
