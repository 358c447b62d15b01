"""Problem documents (RFC 9457): the table of all problem types, and the documents themselves."""
