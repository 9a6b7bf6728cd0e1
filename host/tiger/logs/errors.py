"""What goes wrong with logs."""


class LogError(Exception):
    """A log that cannot be written or read; the message says why and what to do."""
