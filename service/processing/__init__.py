"""Recognition in its own process, the files of a result, and the reading of uploaded recordings."""
