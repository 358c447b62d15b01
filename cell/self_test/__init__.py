"""The self-test of a cell, before its first scan.

In: the settings. Out: a list of checks of arm, camera and mounting, each with its finding and what to do.
"""
