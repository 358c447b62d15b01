"""Child processes for device drivers, with a time limit on each call.

In: a driver class and its arguments. Out: `Child`, which calls the driver's methods over a pipe, and the child's log
records in the parent's log.
"""
