"""The running cell: it prepares, scans, calibrates, verifies and stops.

In: requests of the service or the command line. Out: views, a status, and calibrations. This is the only place that
creates devices and moves the arm.
"""
