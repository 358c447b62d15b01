"""The point chain model, its topology and its JSON document."""
