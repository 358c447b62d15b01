"""Strings whose radius is not given: the radius is measured, and thicker strings beside the given ones are found.

Depth images or the registered surface go in. A radius, or strings with their own radii, come out. Both use
`recognition.strings.find_strings`, as the pipeline does for the given radius.
"""
