"""Measure the accuracy and the speed of recognition on simulated scans, for `pointchain bench`.

In: names of tiers and the number of cases. Out: scores, times and memory, and their Markdown tables. The modules
`reference*` are a literal implementation of the paper, which is the baseline for the speed. The cases are in
`cell.simulation.cases`. The wheel does not contain this package.
"""
