"""Recognition of many recordings by many processes or machines, and the comparison of two runs."""
