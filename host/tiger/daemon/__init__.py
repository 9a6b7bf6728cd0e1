"""The host daemon: supervisor, controller, and the one loop with time and ports."""
