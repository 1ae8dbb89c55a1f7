"""Physics backends; nothing else steps physics."""
