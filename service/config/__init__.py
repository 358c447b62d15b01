"""The configuration: its file, its sections, and messages about errors in it."""
