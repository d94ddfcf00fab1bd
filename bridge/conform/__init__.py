"""Black-box kits of numbered rules, which judge a participant or a drive by what it sends.

Input: a deployment, and a program or a device on its buses. Output: a verdict for each rule, with
what was expected and what came. Nothing here looks into the judged program.
"""
