"""Logs: write, read, replay, plot."""
