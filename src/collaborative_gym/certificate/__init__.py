"""Whether a task needs all of its arms."""
