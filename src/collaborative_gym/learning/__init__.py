"""Learning to work together: training runs on skrl or RLlib."""
