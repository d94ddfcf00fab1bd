"""Links: a signal that arrives late, sometimes, or never. A link is a table.

Whatever the delay law and the semantics, a link comes down to one int32 per hit of the
receiver: *which sent sample it holds* (-1: none yet). What is in this room, in the order in
which it is built up::

    laws        how late a sample is: constant, uniform redrawn every hold, sums
    distributions  gamma, lognormal, normal and hyperexponential delays, cut at a maximum
    markov      delays that stay on a level for a while
    segments    a constant delay but for some segments of time
    traces      delays that were measured, from CSV or Parquet, or of frames on a simulated bus
    zenoh_can   messages of Zenoh in frames of a CAN FD bus
    losses      which packets never arrive: independent, Gilbert–Elliott, Pareto bursts
    outages     losses in seconds: now and then nothing arrives for a while
    presets     delay and loss of networks and of published studies, by name
    frozen      delay traces by name that are the same bytes everywhere
    semantics   when a sample is sent and read, and which one a read holds: six rules
    table       a link as a stream of rows, and the ages of what they hold
    drawing     the rows of many tables at once, by ``tables.c``
    storage     tables as Parquet files: written, recovered, replayed
    keys        laws and models are structs; their fields are read here, with units and messages
    spec        names of laws and models, and the table of a link by its keys
    netem       a law and a loss as arguments of tc netem, and what netem does otherwise

Nothing here depends on an engine, a component or a clock; everything is a pure function of a seed
or of a file, streamed in chunks whose sizes do not matter.
"""
