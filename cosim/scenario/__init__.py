"""A scenario: TOML read into frozen structs, and assembled into a plan.

Input: files and settings. Output: components, connections and a plan. Every error names its place
in the file.
"""
