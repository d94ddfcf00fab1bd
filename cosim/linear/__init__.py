"""Linear models of a scenario at an operating point: A, B, C, D with units and names.

Input: a scenario and a time. Output: matrices of one component, or of the whole sampled loop with
its rates and delays, over one period of the loop; or of the loop with its links cut, from which the
poles follow for any delays (:class:`cosim.linear.opened.OpenLoop`), and samples with which an
adversary drives it (:mod:`cosim.linear.adversary`).
"""
