"""The tasks and the environment ids made of them."""

from importlib import import_module

# The order of the thesis, and so of every list and table; then our own.
_THESIS = "poke", "lift", "balance", "pass_"
_OWN = "balance_path", "hockey", "tug", "reach", "sort", "assemble"
for _name in (*_THESIS, *_OWN):
    import_module(f"{__name__}.{_name}")
