"""Firmware in the loop: a node whose slots are computed by an image, in an emulator or natively.

Input: an image (ELF) and a wired node. Output: the rows, received samples and frames of the image.
"""
