"""Numbers from recorded signals: metrics, manipulability, energy and felt impedance."""
