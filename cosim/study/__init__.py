"""Studies: many runs of one scenario, described by a file, with one table as the result::

    axes       what one axis of a study does to a scenario: listed values, cases, random laws
    spec       what a study file (TOML) may contain
    study      a study as read and checked, every error with its place
    design     axes -> points: grid, Latin hypercube, Monte Carlo; the identity of each run
    memory     a run's signals in memory, no more of them than its metrics need
    run_point  one point -> one row, also if the run fails
    batch      several points at a time
    workers    points spread over processes, threads, or a cluster
    store      the folder: a journal, Parquet parts, nothing lost and nothing done twice
    parts      the runs divided among independent calls, and put together
    runner     how many cases are run, interrupted and taken up again, whatever they are
    execute    all of it
    table      the rows of a study
    summary    the table as lines and as files
    figures    maps, lines and points over the axes

Nothing here depends on robots; a scenario is changed by ``--set`` paths and nothing else.
"""
