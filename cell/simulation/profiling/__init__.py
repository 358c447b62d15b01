"""Simulated cameras with the character of measured ones.

In: depth images of a table. Out: what a simulated camera measures there, and the parameters of the simulated stereo
camera that has the same errors.
"""
