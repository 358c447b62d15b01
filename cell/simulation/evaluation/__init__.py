"""Evaluation of a model against the truth or against another model.

In: two sets of chains. Out: distances, missed and false chains, and the correctness of crossings.
"""
