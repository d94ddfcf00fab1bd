"""A scenario: TOML read into frozen structs, and assembled into a plan.

In come files and settings, out come components, connections and a plan; every error names its
place.
"""
