"""The content of an `.fmu` file: description, variables, ports, values, binaries and sources."""
