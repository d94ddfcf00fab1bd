"""Many runs with faults, each judged: campaigns and soaks.

In come a campaign or soak file and a seed, out come runs (simulated or rehearsed), a judgement of
each, and a table. Runs that are there already are not done again.
"""
