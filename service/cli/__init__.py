"""The command line. Results go to stdout; progress, questions and errors go to stderr."""
