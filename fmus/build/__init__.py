"""The way from a declaration to an ``.fmu`` file, and the components that are made without one.

``source`` writes the C of a declaration, ``description`` the XML, ``toolchain`` finds the compiler,
``library`` compiles, ``archive`` packs the FMU, and ``shipped`` finds those of the installation.
``kernel`` steps the C of a model without FMI, ``reference`` its law in NumPy. ``bus_fmu`` and
``lsbus_fmu`` make FMUs that exchange CAN frames (FMI layered standard for buses).
"""
