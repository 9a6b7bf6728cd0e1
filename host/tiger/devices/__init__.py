"""What the host talks to, one file per device."""
