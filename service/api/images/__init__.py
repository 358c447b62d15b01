"""Images that are drawn on request, and their cache."""
