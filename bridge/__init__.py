"""Real time: nodes, CAN, Zenoh, safety. Knows no model. (An empty room for now.)"""
