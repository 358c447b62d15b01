"""Physics of strings that shapes the scenes of some tiers: knots that are pulled tight, and heaps that fall.

In: centre lines of loose strings. Out: centre lines of the same strings at rest, in contact with each other.
"""
