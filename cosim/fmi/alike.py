"""The common part of FMI 2.0 and FMI 3.0 instances, whose functions differ in names only."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from typing import ClassVar

from cosim.fmi.file.values import NumberedTexts
from cosim.fmi.library import Calls, array_of, uint32
from cosim.native import shared


class CommonInstance:
    """Status, state, end and addresses of an instance.

    `STATE`, `READ` and `HOT` are names of functions without prefix, or parts of them. `HOT`: those
    that set reals, step and get reals. `ENUMERATION`: the type by whose functions enumerations are
    passed.
    """

    STATE: ClassVar[str]
    READ: ClassVar[str]
    HOT: ClassVar[tuple[str, str, str]]
    ENUMERATION: ClassVar[str]
    _calls: Calls
    handle: int
    numbered: NumberedTexts

    @property
    def broken(self) -> int:
        """ERROR or FATAL where one was returned; else OK."""
        return self._calls.broken

    def trapped(self) -> str:
        """Tell what it did in the call that ended it, in WebAssembly; "": nothing."""
        return self._calls.trapped(self.handle)

    @property
    def sandboxed(self) -> bool:
        """True if its binary is WebAssembly."""
        return self._calls.sandboxed

    def watch(self, stop: int) -> None:
        """Let calls in WebAssembly end soon once the number at an address (int32) is not 0."""
        self._calls.watch(self.handle, stop)

    def _suffix(self, verb: str, kind: str) -> str:
        """The name of the function that moves values of an FMI type, without prefix."""
        return verb.capitalize() + (self.ENUMERATION if kind == "Enumeration" else kind)

    def returned(self, status: int) -> None:
        """Take note of a status that the engine got."""
        self._calls.returned(status)

    def refuse(self, suffix: str, status: int) -> None:
        """Raise FmuError for a bad status of a function, its name without the prefix."""
        self._calls.refuse(suffix, status, self.handle)

    def left(self) -> None:
        """Take note that C has left Initialization Mode."""
        self._calls.started = True

    def reset(self) -> None:
        """``fmi2Reset``, ``fmi3Reset``: as after its instantiation, with nothing logged."""
        self._calls.checked("Reset", c.c_void_p)(self.handle)
        self._calls.started = False
        self._calls.log.forget()

    def get_state(self) -> int:
        """``fmi2GetFMUstate``, ``fmi3GetFMUState``."""
        state = c.c_void_p()
        get = self._calls.checked(f"Get{self.STATE}", c.c_void_p, c.c_void_p)
        get(self.handle, c.byref(state))
        return state.value or 0

    def set_state(self, state: int) -> None:
        """``fmi2SetFMUstate``, ``fmi3SetFMUState``."""
        self._calls.checked(f"Set{self.STATE}", c.c_void_p, c.c_void_p)(self.handle, state)

    def serialized(self) -> bytes:
        """The state as bytes: ``fmi2SerializeFMUstate``, ``fmi3SerializeFMUState``."""
        state, size = c.c_void_p(self.get_state()), c.c_size_t()
        try:
            types = (c.c_void_p,) * 3
            self._calls.checked(f"Serialized{self.STATE}Size", *types)(
                self.handle, state, c.byref(size)
            )
            data = c.create_string_buffer(max(1, size.value))
            write = self._calls.checked(f"Serialize{self.STATE}", *types, c.c_size_t)
            write(self.handle, state, data, size.value)
        finally:
            self.free_state(state.value or 0)
        return data.raw[: size.value]

    def set_serialized(self, data: bytes) -> None:
        """Go to a state that was serialized: ``fmi2DeSerializeFMUstate``,
        ``fmi3DeserializeFMUState``.
        """
        state = c.c_void_p()
        types = c.c_void_p, c.c_char_p, c.c_size_t, c.c_void_p
        self._calls.checked(f"{self.READ}{self.STATE}", *types)(
            self.handle, data, len(data), c.byref(state)
        )
        try:
            self.set_state(state.value or 0)
        finally:
            self.free_state(state.value or 0)

    def free_state(self, state: int) -> None:
        """``fmi2FreeFMUstate``, ``fmi3FreeFMUState``."""
        free = self._calls.checked(f"Free{self.STATE}", c.c_void_p, c.c_void_p)
        free(self.handle, c.byref(c.c_void_p(state)))

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], count: int
    ) -> list[float]:
        """``GetDirectionalDerivative`` of variables, `count` scalars in all, in their units."""
        first, second = uint32(unknowns), uint32(knowns)
        given, found = array_of(c.c_double, seed), (c.c_double * count)()
        size, pointer = c.c_size_t, c.c_void_p
        types: tuple[type, ...] = (pointer, pointer, size, pointer, size)
        arguments = (self.handle, first, len(unknowns), second, len(knowns))
        if self._calls.prefix == "fmi2":
            call = self._calls.checked("GetDirectionalDerivative", *types, pointer, pointer)
            call(*arguments, given, found)
        else:
            types = (*types, pointer, size, pointer, size)
            call = self._calls.checked("GetDirectionalDerivative", *types)
            call(*arguments, given, len(seed), found, count)
        return list(found)

    def state_functions(self) -> tuple[int, int]:
        """Addresses of the functions that save the state, and that restore it."""
        names = (f"Get{self.STATE}", f"Set{self.STATE}")
        save, restore = (shared.address(self._calls.function(n)) for n in names)
        return save, restore

    def free(self) -> None:
        """Terminate and FreeInstance, as far as they may be called."""
        if self.handle:
            self._calls.free(self.handle)
            self.handle = 0

    def functions(self) -> dict[int, str]:
        """Names of the functions that were asked for, by address."""
        return self._calls.addresses()

    def loop_functions(self) -> tuple[int, int, int]:
        """Addresses of the three functions `HOT`."""
        set_, step, get = (shared.address(self._calls.function(n)) for n in self.HOT)
        return set_, step, get

    def steps_function(self) -> int:
        """Address of the function that steps several instances at once, which our own FMUs have.

        0: there is none.
        """
        library = self._calls.library
        if getattr(library, f"{self._calls.prefix}_advance", None) is None:
            return 0
        if library.kernel_lanes() < 2:
            return 0
        return shared.address(self._calls.function("_advance"))

    def values_address(self) -> int:
        """The address at which our own FMUs have their values; 0: they are not open."""
        if getattr(self._calls.library, f"{self._calls.prefix}_values", None) is None:
            return 0
        function = self._calls.function("_values", c.c_void_p, result=c.c_void_p)
        return int(function(self.handle) or 0)

    def places(self, reference: int) -> range:
        """The entries of a variable among these values."""
        if self._calls.prefix == "fmi2":
            return range(reference, reference + 1)
        size = c.c_size_t()
        place = self._calls.function("_place", c.c_uint32, c.c_void_p, result=c.c_size_t)
        first = int(place(reference, c.byref(size)))
        return range(first, first + size.value)
