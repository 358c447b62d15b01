"""The other commands, one file for each or for each family."""
