"""Every policy in every seat with every other: who wins, and who fits whom."""
