"""Child processes: for device drivers, with a time limit on each call, and for other Python programs.

In: a driver class and its arguments, or a program. Out: `Child`, which calls the driver's methods over a pipe, and the
child's log records in the parent's log; or a process that ends with its parent (`python_process`).
"""
