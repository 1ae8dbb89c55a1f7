"""Report cards: how good policies are, on one page."""
