"""Numbers that follow from a scenario without a run: gains, ages, passivity and closed forms."""
