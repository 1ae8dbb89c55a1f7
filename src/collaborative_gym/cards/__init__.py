"""Report cards: all that there is to say of policies, on one page."""
