"""Certificates: proofs that a loop is stable whatever the delays of its links within bounds.

Input: a linear loop cut at its links, and bounds of their ages. Output: a file of integers that
proves it, or None; and the exact decision that such a file holds::

    exact         matrices of rational numbers, positive definite or not
    model         the cut loop, its neutral directions, and bounds of links
    nominal       the loop about fixed lateness, and gains that bound the rest
    peaks         bounds of impulse responses, and the decision that they prove stability
    switched      the loop with a matrix for each combination of ages
    checker       the decision that matrices prove stability
    certificate   the file, and its verification
    inequalities  linear matrix inequalities, by a packaged solver
    peak_gain, small_gain, lyapunov, search    candidates: nothing here is trusted
    witness       delays with which a motion grows
    region        what is certified, broken or unknown, over the bounds; figure: as a page
    scenario      the cut loop of a scenario
    theorem       what the theorems of the paper say of a scenario
    steps         from a scenario to a certificate, in words
"""
