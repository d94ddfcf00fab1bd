"""Numbers from a run: metrics, manipulability, impedance, passivity and closed forms."""
