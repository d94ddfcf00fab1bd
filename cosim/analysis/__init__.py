"""Tests of one port of a scenario: what a push, a grip or a shake feels, beside the predictions."""
