"""The end of a scan before its last viewpoint: whether the views so far suffice.

Views go in, one by one. What is doubtful after each view, and the recognition of the views that were needed, come out.
"""
