"""Every policy in every seat with every other: winners, and partners that fit."""
