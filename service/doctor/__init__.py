"""`pointchain doctor`: whether what the store says is there is there, and what can be mended."""
