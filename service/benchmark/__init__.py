"""Benchmark of the simulated cell and the service, and the command `pointchain bench`.

In: the parts to measure. Out: tables or JSON on accuracy, speed, live scans, answers of the service under load, and the
time from a stop request to a still arm. The accuracy and speed parts are in `cell.simulation.benchmark`. The wheel
contains neither.
"""
