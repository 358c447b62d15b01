"""From fitted strands to the chains and crossings of the model, with their uncertainty."""
