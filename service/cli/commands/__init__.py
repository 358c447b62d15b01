"""The other commands, one module per command or family of commands."""
