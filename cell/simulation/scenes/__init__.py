"""Random scenes of strings on a table, with the truth.

In: a scene name and a seed. Out: a `StringScene` whose strings touch but do not intersect.
"""
