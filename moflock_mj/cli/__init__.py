"""The command line: one file per command, printing in `console.py`."""
