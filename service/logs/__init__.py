"""The log of the service: its format, its writer, and the arrival time of the current request."""
