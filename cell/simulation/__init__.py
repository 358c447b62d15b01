"""The simulated cell: scenes, rendering, simulated devices, and the benchmark with known truth, which is not installed.

In: a scene name and a seed. Out: views or a recording, with the truth. Within `cell`, only the equipment of a cell
imports it.
"""
