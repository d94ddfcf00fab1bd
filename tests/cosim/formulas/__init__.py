"""Formulas over signals in time."""
