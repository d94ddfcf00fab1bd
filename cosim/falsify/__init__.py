"""Falsification: the smallest network that breaks a requirement of a scenario, and that it lasts.

Input: a scenario with requirements, and the bounds of its network (``[falsify]``, or those of its
own links). Output: a folder with a scenario that breaks one of them, made as small as possible::

    spec        the table [falsify]
    bounds      what each channel of the scenario may do, and paths made to keep to that
    paths       the delays of a channel over time, and candidates: networks and values to try
    judge       the margins of a run: how far its requirements are from being violated
    evaluation  candidates, run in lanes by a worker
    problem     a scenario as a problem: what of it may move
    families    candidates of each kind, simple ones first
    greedy      the adversary that injects most power into the linear model
    optimizer   segments chosen by CMA-ES
    search      the families in order, until one breaks a requirement
    part_search  candidates divided among independent calls
    rounds      candidates spread over workers; their results kept, so that a search is resumable
    trials      candidates as differences from the nominal one, and simpler ones
    shrinking   the smallest candidate that still fails
    execute     all of it, in a folder
    words       the result in words and as data
    artifacts, scenario_text, page   files of a failure: scenario, runs, report, commands, test
"""
