"""Pictures and videos of worlds."""
