"""The configuration: the loader, the sections, and messages about errors in it."""
