"""Rigid transforms, one at a time and stacked."""
