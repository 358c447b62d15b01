"""The methods of the paper: from centre points to linked segments, and from these to strands and chains."""
