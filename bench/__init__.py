"""Measurements and the data they run on; each module is a command."""
