"""Wang, "Towards Manipulability of Interactive Lagrangian Systems", as data, oracles and claims.

=================  ============================================================================
``experiments``    scenario documents: single arm, six arms, teleoperator
``cases``          every run of the reproduction by name: which document, for which claims
``oracles``        closed forms that a run must agree with
``claims``         the paper's statement (or closed form), the expected value, the measurement
``figures``        Figs 1-15 in the paper's layout
``reproduction``   runs the cases in parallel, checks the claims, draws the figures
=================  ============================================================================

``cosim reproduce`` is the command; ``docs/paper.md`` maps symbols, equations and figures to code.
"""
