"""Problem documents (RFC 9457).

A slug and a message go in, and the document of an HTTP response, of a job or of the command line comes out. The table
of problem types has the title, status, cause and action of each slug.
"""
