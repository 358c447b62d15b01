"""The command line. Machine output goes to stdout, messages for people go to stderr."""
