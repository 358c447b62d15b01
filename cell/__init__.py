"""The robot cell: devices, recordings and the simulated cell.

Live, simulated and recorded scans all give `Iterable[View]` (`cell.devices`), which recognition takes.
"""
