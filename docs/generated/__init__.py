"""Page generators: each module makes one page of the manual from the code that it describes."""
