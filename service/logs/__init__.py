"""The log of the service: its format, its writer, and the lines about requests."""
