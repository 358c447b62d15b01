"""From strands to tubes that are fitted to the measured surface, and which of them are strings."""
