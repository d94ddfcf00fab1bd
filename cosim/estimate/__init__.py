"""Estimate of the local error of a step, by repeating it in two halves.

Input: a plan and a tolerance. Output: local errors of its continuous components, and the step size
that keeps the tolerance.
"""
