"""All nodes of a deployment at once, on the wall clock: started, watched, collected.

Input: a system, settings and a fault script. Output: how the process of each node ended. `hosts`
puts nodes into network namespaces, `host_file`, `placement`, `remote` and `agent` on other hosts;
`injector` and `babbler` carry out a fault script.
"""
