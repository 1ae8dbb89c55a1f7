"""The one environment loop, and its adapters to other libraries' contracts."""
