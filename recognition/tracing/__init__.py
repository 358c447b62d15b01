"""The graph method: from centre points to fragments of strands, and from these to strands."""
