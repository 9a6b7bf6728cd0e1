"""Daemon and emulated robot in one process, in lock-step virtual time."""
