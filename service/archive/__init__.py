"""Many recordings at once: recognised by many processes or machines, kept as lines, compared between two runs."""
