"""Reports that run their scenario again in the browser

In come a scenario and its run; out goes a page in which values can be moved: it holds what it takes
to judge a run in JavaScript, with the numbers and words of Python.
"""
