"""Learning to work together: training runs on skrl, here or with Ray."""
