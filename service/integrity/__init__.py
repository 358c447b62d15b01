"""The integrity check of the data folder: what is damaged, and its repair."""
