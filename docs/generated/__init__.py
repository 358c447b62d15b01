"""Page generators: each module makes pages of the manual from the code that they describe."""
