"""``vendor.h``: drives as their vendors describe them."""

from __future__ import annotations

from bridge.native import enums
from bridge.native.enums import VendorFault, VendorKind
from bridge.native.library import library as functions
from bridge.native.structs import VendorStruct

__all__ = ["VendorFault", "VendorKind", "VendorStruct", "functions"]
QUEUE, PARTS = enums.VENDOR_QUEUE, enums.VENDOR_PARTS
