"""Training runs beside one another: what differs, and how sure that is."""
