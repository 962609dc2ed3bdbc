"""Argument checks, options and processes: nothing of the domain."""
